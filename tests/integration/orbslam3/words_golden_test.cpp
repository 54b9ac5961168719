// SPDX-License-Identifier: Apache-2.0
// Recorded words and searches by words of the reference through the shim.
#include <gtest/gtest.h>

#include <cstddef>
#include <cstdint>
#include <cstring>
#include <filesystem>
#include <fstream>
#include <memory>
#include <string>
#include <utility>
#include <vector>

#include "ft/containers/vocabulary.hpp"
#include "ft/containers/vocabulary_files.hpp"
#include "integration/orbslam3/accelerator.hpp"
#include "tests/conformance/golden_words_input.hpp"
#include "tests/integration/orbslam3/backends.hpp"
#include "tests/integration/orbslam3/plain_words.hpp"
#include "tests/integration/orbslam3/recorded_recovery.hpp"
#include "tests/integration/orbslam3/scene.hpp"
#include "tests/integration/orbslam3/stand_in.hpp"
#include "tests/support/npy.hpp"

namespace orbslam3_test {

namespace word_golden {

using accelerator = ft::orbslam3::accelerator<stand_in::types>;

/// A recorded frame as a keyframe and as a frame.
struct recorded_frame {
  stand_in::frame frame;
  std::vector<std::unique_ptr<stand_in::map_point>> map;

  recorded_frame(std::string const& root, std::string const& name) {
    test::words_frame const f(root, name);
    frame.N = f.size();
    frame.Nleft = f.cameras == 2 ? f.left : -1;
    for (int i = 0; i < f.size(); ++i) {
      stand_in::keypoint k;
      k.angle = f.angle[static_cast<std::size_t>(i)];
      (i < f.left ? frame.mvKeys : frame.mvKeysRight).push_back(k);
    }
    frame.mvKeysUn = frame.mvKeys;
    frame.mDescriptors.create(f.size(), 32, 0);
    std::memcpy(frame.mDescriptors.data, f.orb.data(), 32 * f.orb.size());
  }
  /// The keyframe with the recorded holders, whose points' numbers are rows of the table.
  stand_in::key_frame holding(std::vector<std::int32_t> const& rows) {
    auto k = keyframe_of(frame);
    for (std::int32_t const row : rows) {
      k.points.push_back(nullptr);
      if (row < 0) { continue; }
      while (map.size() <= static_cast<std::size_t>(row)) {
        map.push_back(std::make_unique<stand_in::map_point>());
        map.back()->mnId = map.size() - 1;
      }
      k.points.back() = map[static_cast<std::size_t>(row)].get();
    }
    return k;
  }
};

class recorded_words_of_frames : public on_executor {
protected:
  void SetUp() override {
    on_executor::SetUp();
    if (!std::filesystem::is_directory(recorded_words())) {
      GTEST_SKIP() << "no recorded words here; FT_DATA names the folder that holds golden_words/";
    }
  }
  void TearDown() override {
    for (auto const& path : written_) { std::filesystem::remove(path); }
  }
  static ft::orbslam3::settings settings_of(int levels_up, bool two_cameras) {
    auto s = settings_for(two_cameras ? sensor::fisheye_stereo : sensor::monocular);
    s.most_keypoints = 3000;
    s.levels_up = levels_up;
    return s;
  }
  /// The file of a recorded vocabulary, in ft's binary form: the recordings are not written to.
  std::string file_of(std::string const& name) {
    std::string const at = recorded_words() + "/vocabularies/" + name + "/";
    auto const path =
        std::filesystem::temp_directory_path() /
        ("ft_golden_" + name + std::to_string(reinterpret_cast<std::uintptr_t>(this)));
    if (std::filesystem::exists(path)) { return path.string(); }
    auto const header = test::read_npy<std::int32_t>(at + "k_L_scoring_weighting.npy");
    test::plain_vocabulary v;
    v.header = {header(0), header(1), static_cast<ft::word_scoring>(header(2)),
                static_cast<ft::word_weighting>(header(3))};
    v.parent = test::read_npy<std::int32_t>(at + "parent.npy").data;
    v.word = test::read_npy<std::int32_t>(at + "word.npy").data;
    v.weight = test::read_npy<double>(at + "weight.npy").data;
    v.orb = test::words_descriptors(at + "desc.npy");
    std::ofstream out(path, std::ios::binary);
    written_.push_back(path.string());
    ft::save_vocabulary(out, ft::make_vocabulary(v.arrays()).view());
    return path.string();
  }

private:
  std::vector<std::string> written_;
};

TEST_P(recorded_words_of_frames, are_found) {
  std::string const root = recorded_words();
  int cases = 0;
  for (auto const& folder : test::cases_of(root, "transform")) {
    std::string const name = folder.substr(folder.rfind('/') + 1);
    auto const up = name.rfind("_up");
    auto const before = name.rfind('_', up - 1);
    std::string const vocabulary = name.substr(before + 1, up - before - 1);
    // The large one has no file; groups of leaves above the group's level are not recorded.
    if (vocabulary == "synth" || !test::exists(folder + "/fv_node.npy")) { continue; }
    SCOPED_TRACE(name);
    ++cases;
    auto const s = settings_of(std::stoi(name.substr(up + 3)), false);
    accelerator gpu(make(s), s);
    gpu.load_vocabulary(file_of(vocabulary));
    recorded_frame r(root, name.substr(0, before));
    gpu.compute_bow(r.frame);
    stand_in::bow_vector bag;
    auto const word = test::read_npy<std::uint32_t>(folder + "/bow_word.npy").data;
    auto const value = test::read_npy<double>(folder + "/bow_value.npy").data;
    for (std::size_t i = 0; i < word.size(); ++i) { bag[word[i]] = value[i]; }
    EXPECT_EQ(r.frame.mBowVec, bag);
    stand_in::feature_vector groups;
    auto const node = test::read_npy<std::uint32_t>(folder + "/fv_node.npy").data;
    auto const start = test::read_npy<std::int32_t>(folder + "/fv_start.npy").data;
    auto const index = test::read_npy<std::uint32_t>(folder + "/fv_index.npy").data;
    for (std::size_t i = 0; i < node.size(); ++i) {
      groups[node[i]].assign(index.begin() + start[i], index.begin() + start[i + 1]);
    }
    EXPECT_EQ(r.frame.mFeatVec, groups);
  }
  EXPECT_GE(cases, 4);
}

TEST_P(recorded_words_of_frames, are_searched) {
  std::string const root = recorded_words();
  int cases = 0;
  for (auto const& folder : test::cases_of(root, "bow_search")) {
    auto const said = test::words_case(folder);
    auto const vocabulary = said["vocabulary"].get<std::string>();
    if (vocabulary == "synth_k10_L6") { continue; }  // has no file
    SCOPED_TRACE(folder);
    ++cases;
    recorded_frame from(root, said["keyframe"].get<std::string>());
    recorded_frame to(root, said["frame"].get<std::string>());
    EXPECT_EQ(to.frame.Nleft, said["nleft"].get<int>());
    auto const s = settings_of(said["up"].get<int>(), to.frame.Nleft >= 0);
    accelerator gpu(make(s), s);
    gpu.load_vocabulary(file_of(vocabulary));
    gpu.compute_bow(from.frame);
    gpu.compute_bow(to.frame);
    auto keyframe = from.holding(
        test::read_npy<std::int32_t>(root + "/" + said["kf"].get<std::string>() + "/kf_mp.npy")
            .data);
    auto const n = test::read_npy<std::int32_t>(folder + "/n.npy");
    for (bool const check : {true, false}) {
      std::vector<stand_in::map_point*> found;
      EXPECT_EQ(gpu.search_by_bow(keyframe, to.frame, found, said["ratio"].get<float>(), check),
                n(check ? 0 : 1));
      std::vector<std::int32_t> rows;
      for (auto const* p : found) {
        rows.push_back(p == nullptr ? -1 : static_cast<std::int32_t>(p->mnId));
      }
      EXPECT_EQ(
          rows,
          test::read_npy<std::int32_t>(folder + (check ? "/match.npy" : "/match_noori.npy")).data);
    }
  }
  EXPECT_GE(cases, 10);
}

INSTANTIATE_TEST_SUITE_P(executors, recorded_words_of_frames, ::testing::ValuesIn(executors()),
                         executor_name);

}  // namespace word_golden

}  // namespace orbslam3_test
