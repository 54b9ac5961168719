// SPDX-License-Identifier: Apache-2.0
// Place recognition: frames find the places they were taken at, by descriptors and by images;
// batches, maps, erasure, a full database, moves, bad input.
#include "ft/pipelines/place_recognition.hpp"

#include <gtest/gtest.h>

#include <algorithm>
#include <cstddef>
#include <cstdint>
#include <utility>
#include <vector>

#include "ft/pipelines/orb_extractor.hpp"
#include "tests/support/backends.hpp"
#include "tests/support/plain_vocabulary.hpp"
#include "tests/support/random.hpp"

namespace place_recognition_test {

using ft::keyframe_id;
using frame = std::vector<ft::descriptor>;

constexpr int features = 120;

/// Descriptors of one place.
frame place(test::generator& random) {
  frame f;
  for (int i = 0; i < features - 20; ++i) { f.push_back(random.descriptor()); }
  return f;
}
/// The same place from elsewhere: most descriptors with a few other bits, in another order, and
/// some that are new.
frame seen_again(test::generator& random, frame const& at) {
  frame f;
  for (auto const& d : at) {
    if (random.chance(80)) { f.push_back(random.flipped(d, random.below(4))); }
  }
  for (int i = 0; i < 20; ++i) { f.push_back(random.descriptor()); }
  for (std::size_t i = f.size() - 1; i > 0; --i) {
    std::swap(f[i], f[static_cast<std::size_t>(random.below(static_cast<int>(i)))]);
  }
  return f;
}

ft::place_params params(int keyframes, int frames) {
  ft::place_params p;
  p.keyframes = keyframes;
  p.frames = frames;
  p.features = features;
  p.levels_up = 2;
  return p;
}

template <typename Backend>
class PlaceRecognition : public test::on_backend<Backend> {
protected:
  using exec_type = typename Backend::exec_type;
  using recognition = ft::place_recognition<exec_type>;
  Backend backend;

  ft::vocabulary<exec_type::space> made() {
    auto const host = ft::make_vocabulary(test::drawn_vocabulary(8, 4).arrays());
    return ft::upload(backend.exec, host.view());
  }
  ft::soa<exec_type::space, ft::field::orb> uploaded(std::vector<frame> const& frames) {
    ft::soa<exec_type::space, ft::field::orb> to(features, static_cast<int>(frames.size()));
    for (std::size_t b = 0; b < frames.size(); ++b) {
      auto const v = to.view().slice(static_cast<int>(b));
      int const n = static_cast<int>(frames[b].size());
      ft::copy(backend.exec, ft::array_of<ft::field::orb>(v), frames[b].data(), frames[b].size());
      ft::copy(backend.exec, v.count, &n, 1);
      backend.exec.wait();
    }
    return to;
  }
  void describe(recognition& of, std::vector<frame> const& frames) {
    auto const d = uploaded(frames);
    of.describe(backend.exec, d.view());
    backend.exec.wait();
  }
  keyframe_id add(recognition& to, frame const& f, int map = 0) {
    describe(to, {f});
    return to.add(backend.exec, 0, map);
  }
  std::vector<ft::place_candidate> query(recognition& in, frame const& f) {
    describe(in, {f});
    in.query(backend.exec);
    return in.download(backend.exec);
  }
};
TYPED_TEST_SUITE(PlaceRecognition, test::backends);

TYPED_TEST(PlaceRecognition, FindsPlacesAgain) {
  test::generator random(1);
  auto const& exec = this->backend.exec;
  typename TestFixture::recognition places(exec, this->made(), params(50, 1));
  EXPECT_TRUE(this->query(places, place(random)).empty()) << "empty database";
  std::vector<frame> seen;
  std::vector<keyframe_id> ids;
  for (int i = 0; i < 40; ++i) {
    seen.push_back(place(random));
    ids.push_back(this->add(places, seen.back()));
  }
  EXPECT_EQ(places.size(), 40);
  for (std::size_t i = 0; i < seen.size(); ++i) {
    auto const found = this->query(places, seen_again(random, seen[i]));
    ASSERT_EQ(found.size(), 1u) << i;
    EXPECT_EQ(found[0].keyframe, ids[i]);
    EXPECT_GT(found[0].score, 0.3f);
    EXPECT_EQ(found[0].group_score, found[0].score);
    auto const same = this->query(places, seen[i]);
    ASSERT_EQ(same.size(), 1u);
    EXPECT_NEAR(same[0].score, 1.0f, 1e-6f);
  }
  EXPECT_TRUE(this->query(places, {}).empty());
}

TYPED_TEST(PlaceRecognition, BatchIsOneAfterTheOther) {
  test::generator random(2);
  auto const& exec = this->backend.exec;
  using places_type = typename TestFixture::recognition;
  auto const words = this->made();
  places_type single(exec, words.view(), params(30, 1));
  places_type batch(exec, words.view(), params(30, 4));
  std::vector<frame> seen;
  for (int i = 0; i < 24; ++i) { seen.push_back(place(random)); }
  std::vector<keyframe_id> ids;
  for (int i = 0; i < 24; i += 4) {
    this->describe(batch, {seen.begin() + i, seen.begin() + i + 4});
    for (int k = 0; k < 4; ++k) {
      auto const at = static_cast<std::size_t>(i + k);
      ids.push_back(this->add(single, seen[at], k % 2));
      EXPECT_EQ(batch.add(exec, k, k % 2), ids.back());
      ft::keyframe_neighbours near;
      near.count = std::min(static_cast<int>(at), 10);
      for (int n = 0; n < near.count; ++n) {
        near.of[n] = ids[at - 1 - static_cast<std::size_t>(n)];
      }
      single.set_neighbours(exec, ids.back(), near);
      batch.set_neighbours(exec, ids.back(), near);
    }
  }
  for (int round = 0; round < 5; ++round) {
    std::vector<frame> frames;
    std::vector<int> maps;
    for (int k = 0; k < 4; ++k) {
      frames.push_back(seen_again(random, seen[static_cast<std::size_t>(random.below(24))]));
      maps.push_back(random.below(2));
    }
    this->describe(batch, frames);
    batch.query(exec, {maps.data(), 4});
    for (int k = 0; k < 4; ++k) {
      auto const at = static_cast<std::size_t>(k);
      this->describe(single, {frames[at]});
      single.query(exec, {&maps[at], 1});
      auto const want = single.download(exec);
      auto const got = batch.download(exec, k);
      ASSERT_EQ(got.size(), want.size());
      for (std::size_t i = 0; i < got.size(); ++i) {
        EXPECT_EQ(got[i].keyframe, want[i].keyframe);
        EXPECT_EQ(got[i].score, want[i].score);
        EXPECT_EQ(got[i].group_score, want[i].group_score);
      }
    }
  }
}

TYPED_TEST(PlaceRecognition, CallsTakeEffectInTheirOrder) {
  test::generator random(3);
  auto const& exec = this->backend.exec;
  typename TestFixture::recognition places(exec, this->made(), params(3, 1));
  frame const here = place(random);
  keyframe_id const a = this->add(places, here);
  keyframe_id const b = this->add(places, place(random));
  // Nothing waits between these calls.
  auto const view = this->uploaded({here});
  places.describe(exec, view.view());
  places.query(exec);
  places.erase(exec, a);
  keyframe_id const c = places.add(exec);
  auto const before = places.download(exec);
  ASSERT_EQ(before.size(), 1u);
  EXPECT_EQ(before[0].keyframe, a);
  EXPECT_FALSE(places.contains(a));
  EXPECT_TRUE(places.contains(c));
  EXPECT_EQ(c.slot, a.slot) << "the slot was used again, the answer kept its number";
  places.query(exec);
  auto const after = places.download(exec);
  ASSERT_EQ(after.size(), 1u);
  EXPECT_EQ(after[0].keyframe, c);
  places.erase(exec, c);
  places.erase(exec, b);
  places.query(exec);
  EXPECT_TRUE(places.download(exec).empty());
  EXPECT_EQ(places.size(), 0);
}

TYPED_TEST(PlaceRecognition, MapsAreApart) {
  test::generator random(4);
  auto const& exec = this->backend.exec;
  typename TestFixture::recognition places(exec, this->made(), params(3, 1));
  frame const here = place(random);
  keyframe_id const a = this->add(places, here, 5);
  EXPECT_TRUE(this->query(places, here).empty());
  int const five = 5;
  places.query(exec, {&five, 1});
  ASSERT_EQ(places.download(exec).size(), 1u);
  places.move(exec, a, 0);
  EXPECT_EQ(this->query(places, here).size(), 1u);
}

TYPED_TEST(PlaceRecognition, SaysThatItIsFull) {
  test::generator random(5);
  auto const& exec = this->backend.exec;
  typename TestFixture::recognition places(exec, this->made(), params(2, 1));
  frame const first = place(random);
  keyframe_id const a = this->add(places, first);
  this->add(places, place(random));
  EXPECT_THROW(this->add(places, place(random)), ft::error);
  EXPECT_EQ(places.size(), 2);
  EXPECT_EQ(this->query(places, first)[0].keyframe, a) << "nothing was overwritten";
  places.erase(exec, a);
  frame const third = place(random);
  keyframe_id const c = this->add(places, third);
  EXPECT_EQ(this->query(places, third)[0].keyframe, c);
}

TYPED_TEST(PlaceRecognition, FindsImagesAgain) {
  auto const& exec = this->backend.exec;
  constexpr int width = 320;
  constexpr int height = 240;
  ft::orb_params orb;
  orb.width = width;
  orb.height = height;
  orb.features = 300;
  orb.levels = 4;
  ft::orb_extractor<typename TypeParam::exec_type> extractor(exec, orb, 1);
  ft::place_params p = params(20, 1);
  p.features = extractor.capacity();
  typename TestFixture::recognition places(exec, this->made(), p);
  // A window of a larger image, and another one a few pixels beside it.
  auto const extract = [&](unsigned seed, int dx, int dy) {
    auto const image = test::random_image(width + 40, height + 40, seed);
    extractor.upload(exec, 0, {image.data() + dy * (width + 40) + dx, width, height, width + 40});
    exec.wait();
    extractor.extract(exec);
    places.describe(exec, extractor.keypoints());
  };
  std::vector<keyframe_id> ids;
  for (unsigned seed = 0; seed < 12; ++seed) {
    extract(seed, 5, 7);
    ids.push_back(places.add(exec));
  }
  for (unsigned seed = 0; seed < 12; ++seed) {
    extract(seed, 17, 2);
    places.query(exec);
    auto const found = places.download(exec);
    ASSERT_FALSE(found.empty()) << seed;
    auto const best = std::max_element(
        found.begin(), found.end(), [](auto const& a, auto const& b) { return a.score < b.score; });
    EXPECT_EQ(best->keyframe, ids[seed]);
  }
}

TYPED_TEST(PlaceRecognition, CanBeMoved) {
  test::generator random(6);
  auto const& exec = this->backend.exec;
  using places_type = typename TestFixture::recognition;
  frame const here = place(random);
  places_type a(exec, this->made(), params(3, 1));
  keyframe_id const id = this->add(a, here);
  places_type b(std::move(a));
  EXPECT_EQ(this->query(b, here)[0].keyframe, id);
  auto const d = this->uploaded({here});
  for (places_type* const empty : {&a}) {
    EXPECT_THROW(empty->describe(exec, d.view()), ft::bad_argument);
    EXPECT_THROW(empty->query(exec), ft::bad_argument);
    EXPECT_THROW(empty->add(exec), ft::bad_argument);
    EXPECT_THROW(empty->erase(exec, id), ft::bad_argument);
    EXPECT_THROW(empty->set_neighbours(exec, id, {}), ft::bad_argument);
    EXPECT_THROW(empty->move(exec, id, 1), ft::bad_argument);
    EXPECT_THROW(empty->download(exec), ft::bad_argument);
    EXPECT_FALSE(empty->contains(id));
    EXPECT_EQ(empty->size(), 0);
  }
  a = std::move(b);
  EXPECT_EQ(this->query(a, here)[0].keyframe, id);
}

TYPED_TEST(PlaceRecognition, RefusesBadInput) {
  test::generator random(7);
  auto const& exec = this->backend.exec;
  using places_type = typename TestFixture::recognition;
  auto const words = this->made();
  auto const make = [&](auto const& change) {
    auto p = params(3, 2);
    change(p);
    places_type const r(exec, words.view(), p);
  };
  EXPECT_NO_THROW(make([](auto&) {}));
  EXPECT_THROW(make([](auto& p) { p.keyframes = 0; }), ft::bad_argument);
  EXPECT_THROW(make([](auto& p) { p.features = 0; }), ft::bad_argument);
  EXPECT_THROW(make([](auto& p) { p.frames = 0; }), ft::bad_argument);
  EXPECT_THROW(make([](auto& p) { p.levels_up = -1; }), ft::bad_argument);
  EXPECT_THROW(places_type(exec, ft::vocabulary_view{}, params(3, 1)), ft::bad_argument);

  places_type places(exec, words.view(), params(3, 2));
  places.query(exec);  // frames that were never described have no words
  EXPECT_TRUE(places.download(exec, 1).empty());
  auto const one = this->uploaded({place(random)});
  EXPECT_THROW(places.describe(exec, one.view()), ft::bad_argument);
  int const maps[3] = {};
  EXPECT_THROW(places.query(exec, {maps, 1}), ft::bad_argument);
  EXPECT_THROW(places.query(exec, {maps, 3}), ft::bad_argument);
  EXPECT_THROW(places.add(exec, 2), ft::bad_argument);
  EXPECT_THROW(places.add(exec, -1), ft::bad_argument);
  EXPECT_EQ(places.size(), 0);
  EXPECT_THROW(places.download(exec, 2), ft::bad_argument);
  EXPECT_THROW(places.erase(exec, {}), ft::bad_argument);
  keyframe_id const id = places.add(exec);
  ft::keyframe_neighbours many;
  many.count = 11;
  EXPECT_THROW(places.set_neighbours(exec, id, many), ft::bad_argument);
  places.erase(exec, id);
  EXPECT_THROW(places.erase(exec, id), ft::bad_argument);
  EXPECT_THROW(places.move(exec, id, 1), ft::bad_argument);
  exec.wait();
}

}  // namespace place_recognition_test
