// SPDX-License-Identifier: Apache-2.0
// Words of frames and keyframes and the search by words through the shim: against plain loops, with
// input that is refused, and in verify.
#include <gtest/gtest.h>

#include <cstddef>
#include <cstdint>
#include <cstring>
#include <filesystem>
#include <fstream>
#include <functional>
#include <memory>
#include <sstream>
#include <stdexcept>
#include <string>
#include <system_error>
#include <thread>
#include <utility>
#include <vector>

#include "ft/containers/vocabulary_files.hpp"
#include "ft/containers/vocabulary_text.hpp"
#include "integration/orbslam3/front_end.hpp"
#include "tests/integration/orbslam3/backends.hpp"
#include "tests/integration/orbslam3/heard.hpp"
#include "tests/integration/orbslam3/plain_words.hpp"
#include "tests/integration/orbslam3/scene.hpp"
#include "tests/integration/orbslam3/stand_in.hpp"
#include "tests/integration/orbslam3/two_views.hpp"

namespace orbslam3_test {

namespace word_shim {

using accelerator = ft::orbslam3::accelerator<stand_in::types>;
using front_end = ft::orbslam3::front_end<stand_in::types>;
using verifier = ft::orbslam3::verifier<stand_in::types>;
using ft::orbslam3::difference;
using ft::orbslam3::stage;
using matches = std::vector<stand_in::map_point*>;

constexpr int up = two_views::up;

/// A folder of this process and test, which goes with it.
class folder {
public:
  folder() {
    auto const* const test = ::testing::UnitTest::GetInstance()->current_test_info();
    std::string name = std::string("ft_words_") + test->name() +
                       std::to_string(reinterpret_cast<std::uintptr_t>(this));
    for (char& c : name) { c = c == '/' ? '_' : c; }
    path_ = std::filesystem::temp_directory_path() / name;
    std::filesystem::create_directories(path_);
  }
  folder(folder const&) = delete;
  folder& operator=(folder const&) = delete;
  ~folder() {
    std::error_code failed;
    std::filesystem::remove_all(path_, failed);
  }
  std::string file(char const* name) const { return (path_ / name).string(); }

private:
  std::filesystem::path path_;
};

/// The text form numbers words by line.
test::plain_vocabulary some_vocabulary() {
  test::generator random(7);
  auto v = test::random_vocabulary(random, 6, 4, 3);
  int words = 0;
  for (int& w : v.word) { w = w < 0 ? -1 : words++; }
  return v;
}

class words : public on_executor {
protected:
  words() : vocabulary(some_vocabulary()), plain(vocabulary) {}
  std::string text() {
    write_text(files.file("words.txt"), vocabulary);
    return files.file("words.txt");
  }
  folder files;
  test::plain_vocabulary vocabulary;
  plain_words plain;
};

int never() { throw std::runtime_error("the CPU was asked"); }

TEST_P(words, of_frames_and_keyframes_are_the_plain_ones) {
  for (sensor const kind : all_sensors) {
    SCOPED_TRACE(name_of(kind));
    two_views v(kind);
    accelerator gpu(make(v.settings), v.settings);
    gpu.load_vocabulary(text());
    auto want = v;
    want.transform(plain);
    gpu.compute_bow(v.frame);
    gpu.compute_bow(v.keyframe);
    EXPECT_EQ(v.frame.mBowVec, want.frame.mBowVec);
    EXPECT_EQ(v.frame.mFeatVec, want.frame.mFeatVec);
    EXPECT_EQ(v.keyframe.mBowVec, want.keyframe.mBowVec);
    EXPECT_EQ(v.keyframe.mFeatVec, want.keyframe.mFeatVec);
    EXPECT_GT(v.frame.mFeatVec.size(), 3u);
    // Computed once.
    v.frame.mBowVec = {};
    v.frame.mBowVec[77] = 1;
    gpu.compute_bow(v.frame);
    EXPECT_EQ(v.frame.mBowVec.size(), 1u);
  }
}

TEST_P(words, are_searched_as_by_plain_loops) {
  int found = 0;
  int dropped = 0;
  int right = 0;
  for (sensor const kind : all_sensors) {
    for (unsigned const seed : {3u, 4u}) {
      SCOPED_TRACE(std::string(name_of(kind)) + " seed " + std::to_string(seed));
      two_views v(kind, seed);
      v.transform(plain);
      accelerator gpu(make(v.settings), v.settings);
      int by_check[2] = {};
      for (float const ratio : {0.7f, 0.75f, 0.9f}) {
        for (bool const check : {false, true}) {
          matches got(3), want;
          int const n = plain_word_search(v.keyframe, v.frame, ratio, check).run(want);
          EXPECT_EQ(gpu.search_by_bow(v.keyframe, v.frame, got, ratio, check), n);
          EXPECT_EQ(got, want);
          by_check[check ? 1 : 0] = n;
          for (std::size_t i = 0; v.frame.Nleft >= 0 && i < got.size(); ++i) {
            right += static_cast<int>(got[i] != nullptr && static_cast<int>(i) >= v.frame.Nleft);
          }
        }
      }
      found += by_check[1];
      dropped += by_check[0] - by_check[1];
    }
  }
  EXPECT_GT(found, 200);
  EXPECT_GT(dropped, 10);
  EXPECT_GT(right, 20);
}

/// What changes between calls, fewer keypoints among it: nothing stays from the call before.
TEST_P(words, are_searched_anew_in_every_call) {
  two_views large(sensor::stereo, 3);
  large.transform(plain);
  accelerator gpu(make(large.settings), large.settings);
  auto const expect_plain = [&](two_views& v) {
    matches got, want;
    int const n = plain_word_search(v.keyframe, v.frame, 0.75f, true).run(want);
    EXPECT_EQ(gpu.search_by_bow(v.keyframe, v.frame, got, 0.75f), n);
    EXPECT_EQ(got, want);
    return n;
  };
  int const all = expect_plain(large);
  for (std::size_t i = 0; i < large.keyframe.points.size(); i += 3) {
    large.keyframe.points[i] = nullptr;
  }
  for (std::size_t i = 1; i < large.keyframe.points.size(); i += 6) {
    if (large.keyframe.points[i] != nullptr) { large.keyframe.points[i]->SetBadFlag(); }
  }
  EXPECT_LT(expect_plain(large), all);
  scene const other(sensor::stereo, 5, 60);
  two_views small(sensor::stereo, 3);
  small.frame = other.current;
  small.keyframe = keyframe_of(other.last);
  small.transform(plain);
  expect_plain(small);
  for (auto* const groups : {&small.keyframe.mFeatVec, &small.frame.mFeatVec}) {
    groups->erase(groups->begin());
  }
  expect_plain(small);
}

TEST_P(words, of_keyframes_are_found_by_another_thread_meanwhile) {
  two_views v(sensor::stereo);
  ft::orbslam3::options o;
  o.vocabulary = text();
  front_end gpu(make(v.settings), v.settings, o);
  auto want = v;
  want.transform(plain);
  matches plain_matches;
  int const n = plain_word_search(want.keyframe, want.frame, 0.7f, true).run(plain_matches);
  std::vector<stand_in::key_frame> made(12, v.keyframe);
  std::thread mapping([&] {
    for (auto& k : made) { gpu.compute_bow(k, never); }
  });
  for (int k = 0; k < 12; ++k) {
    auto f = v.frame;
    gpu.compute_bow(f, never);
    EXPECT_EQ(f.mFeatVec, want.frame.mFeatVec);
    matches got;
    EXPECT_EQ(gpu.search_by_bow(want.keyframe, f, got, 0.7f, true, never), n);
    EXPECT_EQ(got, plain_matches);
  }
  mapping.join();
  for (auto const& k : made) { EXPECT_EQ(k.mBowVec, want.keyframe.mBowVec); }
}

// ---- the vocabulary's file ----------------------------------------------------------------------

TEST_P(words, come_from_the_text_and_from_the_binary_form) {
  two_views v(sensor::monocular);
  auto want = v;
  want.transform(plain);
  auto const transformed = [&](std::string const& from) {
    accelerator gpu(make(v.settings), v.settings);
    gpu.load_vocabulary(from);
    auto f = v.frame;
    gpu.compute_bow(f);
    return f.mBowVec;
  };
  std::string const path = text();
  EXPECT_EQ(transformed(path), want.frame.mBowVec);
  std::string const binary = files.file("words.ft");
  {
    std::ifstream from(path, std::ios::binary);
    std::ofstream to(binary, std::ios::binary);
    ft::save_vocabulary(to, ft::read_vocabulary_text(from).view());
  }
  EXPECT_EQ(transformed(binary), want.frame.mBowVec);
  std::ofstream(binary, std::ios::app) << "x";
  EXPECT_THROW(transformed(binary), ft::error);
  std::ofstream(path, std::ios::app) << "\n";
  EXPECT_EQ(transformed(path), want.frame.mBowVec);
}

TEST_P(words, without_a_vocabulary_are_the_cpus) {
  two_views v(sensor::stereo);
  for (std::string const& path : {std::string(), files.file("missing.txt")}) {
    heard said;
    ft::orbslam3::options o;
    o.vocabulary = path;
    front_end gpu(make(v.settings), v.settings, o);
    int calls = 0;
    auto f = v.frame;
    gpu.compute_bow(f, [&] {
      ++calls;
      plain.transform(f, up);
    });
    EXPECT_EQ(calls, 1);
    EXPECT_EQ(said.lines(), path.empty() ? 0 : 1) << said.text();
    EXPECT_TRUE(path.empty() || said.has("missing.txt': cannot be opened"));
    // The others go on.
    auto k = v.keyframe;
    plain.transform(k, up);
    matches got;
    EXPECT_GT(gpu.search_by_bow(k, f, got, 0.75f, true, never), 0);
  }
  accelerator alone(make(v.settings), v.settings);
  EXPECT_FALSE(alone.can_compute_bow(v.frame));
  EXPECT_THROW(alone.compute_bow(v.frame), ft::bad_argument);
}

// ---- input that is refused ----------------------------------------------------------------------

TEST_P(words, of_frames_without_descriptors_are_the_cpus) {
  two_views v(sensor::stereo);
  ft::orbslam3::options o;
  o.vocabulary = text();
  front_end gpu(make(v.settings), v.settings, o);
  accelerator alone(make(v.settings), v.settings);
  alone.load_vocabulary(o.vocabulary);
  stand_in::frame empty;
  stand_in::frame other_width = v.frame;
  other_width.mDescriptors.create(20, 16, 0);
  stand_in::frame many = v.frame;
  many.mDescriptors.create(100000, 32, 0);
  for (auto* const f : {&empty, &other_width, &many}) {
    int calls = 0;
    gpu.compute_bow(*f, [&] { ++calls; });
    EXPECT_EQ(calls, 1);
    EXPECT_THROW(alone.compute_bow(*f), ft::bad_argument);
    EXPECT_TRUE(f->mBowVec.empty());
  }
  EXPECT_TRUE(gpu.uses(stage::transform));
}

TEST_P(words, that_do_not_fit_their_frames_are_not_searched) {
  two_views good(sensor::fisheye_stereo);
  good.transform(plain);
  front_end gpu(make(good.settings), good.settings, {});
  struct broken {
    stand_in::frame frame;
    stand_in::key_frame keyframe;
  };
  using change = std::function<void(broken&)>;
  change const spoilt[] = {
      [](broken& v) { v.keyframe.mFeatVec.clear(); },
      [](broken& v) { v.frame.mFeatVec.clear(); },
      [](broken& v) { v.keyframe.points.pop_back(); },
      [](broken& v) { v.keyframe.mDescriptors = {}; },
      [](broken& v) { v.frame.mDescriptors.resize(10); },
      [](broken& v) { v.frame.mvKeysRight.pop_back(); },
      [](broken& v) { v.keyframe.mvKeys.pop_back(); },
      [](broken& v) { v.frame.Nleft -= 1; },
      [](broken& v) { v.frame.mFeatVec.begin()->second.push_back(1u << 30); },
      [](broken& v) { v.keyframe.mFeatVec.begin()->second.push_back(0xffffffffu); },
      [](broken& v) {
        auto& list = v.frame.mFeatVec.begin()->second;
        list.push_back(list.front());  // twice
      },
  };
  for (auto const& spoil : spoilt) {
    broken v{good.frame, good.keyframe};
    spoil(v);
    matches got(5);
    int calls = 0;
    EXPECT_EQ(gpu.search_by_bow(v.keyframe, v.frame, got, 0.7f, true,
                                [&] {
                                  EXPECT_EQ(got.size(), 5u);
                                  ++calls;
                                  return 321;
                                }),
              321);
    EXPECT_EQ(calls, 1);
  }
  matches got;
  EXPECT_GT(gpu.search_by_bow(good.keyframe, good.frame, got, 0.75f, true, never), 0);
}

TEST_P(words, are_the_cpus_by_option_and_are_never_bypassed) {
  two_views v(sensor::stereo);
  v.transform(plain);
  ft::orbslam3::options o;
  ft::orbslam3::set_modes(o, "search_by_bow,transform", ft::orbslam3::stage_mode::host);
  o.vocabulary = files.file("not_read.txt");
  heard said;
  front_end gpu(make(v.settings), v.settings, o);
  matches got;
  EXPECT_EQ(gpu.search_by_bow(v.keyframe, v.frame, got, 0.7f, true, [] { return 5; }), 5);
  EXPECT_EQ(said.lines(), 0) << said.text();
  for (char const* const name : {"transform", "search_by_bow"}) {
    EXPECT_THROW(ft::orbslam3::set_modes(o, name, ft::orbslam3::stage_mode::bypass),
                 ft::bad_argument);
  }
}

// ---- verify -------------------------------------------------------------------------------------

class words_verify : public words {
protected:
  /// Both stages with verify; `plant` changes the CPU's answers. @return what differed
  std::vector<std::string> verified(std::function<void(stand_in::frame&)> const& plant_words,
                                    std::function<int(matches&)> const& plant_matches) {
    two_views v(sensor::fisheye_stereo);
    if (!gpu_) {
      gpu_ = std::make_unique<accelerator>(make(v.settings), v.settings);
      gpu_->load_vocabulary(text());
    }
    std::vector<std::string> found;
    verifier both(*gpu_, [&](difference const& d) { found.emplace_back(d.what); });
    auto want = v.frame;
    plain.transform(want, up);
    both.compute_bow(v.frame, [&] {
      plain.transform(v.frame, up);
      plant_words(v.frame);
    });
    EXPECT_EQ(v.frame.mBowVec, want.mBowVec);
    EXPECT_EQ(v.frame.mFeatVec, want.mFeatVec);
    plain.transform(v.keyframe, up);
    matches got, plain_matches;
    int const n = plain_word_search(v.keyframe, want, 0.7f, true).run(plain_matches);
    std::size_t const before = found.size();
    int calls = 0;
    EXPECT_EQ(both.search_by_bow(v.keyframe, v.frame, got, 0.7f, true,
                                 [&] {
                                   ++calls;
                                   int const cpu =
                                       plain_word_search(v.keyframe, want, 0.7f, true).run(got);
                                   return cpu + plant_matches(got);
                                 }),
              n);
    EXPECT_EQ(calls, found.size() > before ? 4 : 2);
    EXPECT_EQ(got, plain_matches);
    return found;
  }

private:
  std::unique_ptr<accelerator> gpu_;
};

TEST_P(words_verify, finds_nothing_where_the_cpu_has_the_same_answer) {
  EXPECT_EQ(verified([](stand_in::frame&) {}, [](matches&) { return 0; }),
            std::vector<std::string>{});
}

TEST_P(words_verify, finds_each_difference_and_keeps_the_accelerators_answer) {
  using list = std::vector<std::string>;
  auto const same_words = [](stand_in::frame&) {};
  auto const same_matches = [](matches&) { return 0; };
  EXPECT_EQ(
      verified([](stand_in::frame& f) { f.mBowVec.begin()->second *= 1.0000001; }, same_matches),
      list{"value of word"});
  EXPECT_EQ(verified([](stand_in::frame& f) { f.mBowVec.erase(f.mBowVec.begin()); }, same_matches),
            list{"value of word"});
  EXPECT_EQ(verified([](stand_in::frame& f) { f.mBowVec[1u << 20] = 0.5; }, same_matches),
            list{"value of word"});
  EXPECT_EQ(
      verified([](stand_in::frame& f) { f.mFeatVec.begin()->second.pop_back(); }, same_matches),
      list{"keypoints of node"});
  EXPECT_EQ(
      verified([](stand_in::frame& f) { f.mFeatVec.begin()->second.back() += 1; }, same_matches),
      list{"keypoints of node"});
  EXPECT_EQ(verified([](stand_in::frame& f) { f.mFeatVec[1u << 20] = {1}; }, same_matches),
            list{"keypoints of node"});
  EXPECT_EQ(verified(same_words, [](matches&) { return 1; }), list{"matches"});
  EXPECT_EQ(verified(same_words,
                     [](matches& m) {
                       for (auto*& p : m) {
                         if (p == nullptr) { continue; }
                         p = nullptr;
                         break;
                       }
                       return 0;
                     }),
            list{"map point of keypoint"});
}

TEST_P(words_verify, adds_keyframes_of_another_thread_to_the_frames_line) {
  two_views v(sensor::stereo);
  accelerator gpu(make(v.settings), v.settings);
  gpu.load_vocabulary(text());
  verifier both(gpu, nullptr);
  std::thread([&] {
    auto k = v.keyframe;
    both.compute_bow(k, [&] {
      plain.transform(k, up);
      k.mBowVec.begin()->second += 1;
    });
    EXPECT_LT(k.mBowVec.begin()->second, 1);
  }).join();
  EXPECT_EQ(both.differences(), 0);
  both.compute_bow(v.frame, [&] { plain.transform(v.frame, up); });
  EXPECT_EQ(both.differences(), 1);
  std::ostringstream summary;
  both.summary(summary);
  EXPECT_EQ(summary.str(),
            "verify: 1 frames, 1 with differences\n"
            "verify: transform: 2 calls, 1 with differences, 1 in all\n");
}

TEST_P(words_verify, keeps_the_cpus_answer_where_the_accelerator_refuses) {
  two_views v(sensor::stereo);
  v.transform(plain);
  v.keyframe.mFeatVec.clear();
  ft::orbslam3::options o;
  o.verify = true;
  heard said;
  front_end gpu(make(v.settings), v.settings, o);
  matches got;
  EXPECT_EQ(gpu.search_by_bow(v.keyframe, v.frame, got, 0.7f, true,
                              [&] {
                                got.assign(7, nullptr);
                                return 3;
                              }),
            3);
  EXPECT_EQ(got.size(), 7u);
  std::ostringstream summary;
  gpu.print(summary);
  EXPECT_EQ(summary.str(),
            "verify: 1 frames, 0 with differences\n"
            "verify: search_by_bow: 1 calls, 0 with differences, 0 in all, 1 refused\n");
}

INSTANTIATE_TEST_SUITE_P(executors, words, ::testing::ValuesIn(executors()), executor_name);
INSTANTIATE_TEST_SUITE_P(executors, words_verify, ::testing::ValuesIn(executors()), executor_name);

}  // namespace word_shim

}  // namespace orbslam3_test
