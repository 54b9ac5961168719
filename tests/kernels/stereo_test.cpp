// SPDX-License-Identifier: Apache-2.0
// Rectified stereo: known shifts, a plain reading of section 5 of the specification, pairs without
// keypoints, keypoints at the rim, and the cut of outliers against a sort. Two cameras: the two
// ways to triangulate, the nearest two of many descriptors.
#include "ft/containers/stereo_matches.hpp"
#include "ft/kernels/stereo/detail/triangulation.hpp"
#include "ft/kernels/stereo/outlier_cut.hpp"
#include "ft/kernels/stereo/rectified.hpp"

#include <gtest/gtest.h>

#include <algorithm>
#include <bitset>
#include <cmath>
#include <cstddef>
#include <cstdint>
#include <limits>
#include <random>
#include <utility>
#include <vector>

#include "ft/containers/keypoints.hpp"
#include "ft/core/execution.hpp"
#include "ft/pipelines/orb_extractor.hpp"
#include "tests/support/backends.hpp"
#include "tests/support/random.hpp"

namespace stereo_test {

inline constexpr int width = 320;
inline constexpr int height = 200;
using image = std::vector<std::uint8_t>;

/// Two views of a plane at one depth: what is at x in the left image is at x - shift in the right
/// one.
inline std::pair<image, image> shifted_pair(int shift, unsigned seed) {
  int const wide = width + shift;
  auto const scene = test::random_image(wide, height, seed);
  std::pair<image, image> views;
  for (int y = 0; y < height; ++y) {
    auto const row = scene.begin() + static_cast<std::ptrdiff_t>(y) * wide;
    views.first.insert(views.first.end(), row, row + width);
    views.second.insert(views.second.end(), row + shift, row + shift + width);
  }
  return views;
}

/// Keypoints of one image on the host.
struct keypoint {
  float x, y;
  int octave;
  ft::descriptor orb;
};
struct match {
  float right_x, depth;
  int score;
  int rival = 0;
  float rows = 0;  ///< row_difference
};

inline float product(float a, float b) {
  float volatile const p = a * b;  // never fused with what follows
  return p;
}

/// Section 5, steps 1 to 4, one left keypoint after the other.
class plain_matcher {
public:
  plain_matcher(ft::pyramid_geometry geometry, std::vector<std::uint8_t> left,
                std::vector<std::uint8_t> right, float bf, float max_disparity)
      : g_(geometry),
        left_(std::move(left)),
        right_(std::move(right)),
        bf_(bf),
        max_disparity_(max_disparity) {}

  std::vector<match> run(std::vector<keypoint> const& left,
                         std::vector<keypoint> const& right) const {
    std::vector<match> all;
    for (auto const& k : left) { all.push_back(find(k, right)); }
    std::vector<int> scores;
    for (auto const& m : all) {
      if (m.score >= 0) { scores.push_back(m.score); }
    }
    if (scores.empty()) { return all; }
    std::sort(scores.begin(), scores.end());
    float const limit = product(1.5f * 1.4f, static_cast<float>(scores[scores.size() / 2]));
    for (auto& m : all) {
      if (static_cast<float>(m.score) >= limit) { m = {-1, -1, -1}; }
    }
    return all;
  }

private:
  match find(keypoint const& k, std::vector<keypoint> const& right) const {
    match const none{-1, -1, -1};
    int best = 100;
    keypoint const* partner = nullptr;
    for (auto const& r : right) {
      float const band = product(2.0f, g_.scale[r.octave]);
      int const row = static_cast<int>(k.y);
      if (row < static_cast<int>(std::floor(r.y - band)) ||
          row > static_cast<int>(std::ceil(r.y + band))) {
        continue;
      }
      if (std::abs(r.octave - k.octave) > 1) { continue; }
      if (!(r.x >= k.x - max_disparity_ && r.x <= k.x)) { continue; }
      int distance = 0;
      for (int w = 0; w < 8; ++w) {
        distance += static_cast<int>(std::bitset<32>(k.orb.words[w] ^ r.orb.words[w]).count());
      }
      if (distance < best) {
        best = distance;
        partner = &r;
      }
    }
    if (partner == nullptr || best >= 75) { return none; }
    float const inv = g_.inv_scale[k.octave];
    int const ul = static_cast<int>(std::round(product(k.x, inv)));
    int const vl = static_cast<int>(std::round(product(k.y, inv)));
    int const ur = static_cast<int>(std::round(product(partner->x, inv)));
    if (ur < 0 || ur + 11 >= g_.width[k.octave]) { return none; }
    auto const sad = [&](int shift) {
      int sum = 0;
      for (int dy = -5; dy <= 5; ++dy) {
        for (int dx = -5; dx <= 5; ++dx) {
          sum += std::abs(at(left_, k.octave, ul + dx, vl + dy) -
                          at(right_, k.octave, ur + shift + dx, vl + dy));
        }
      }
      return sum;
    };
    int shift = -5;
    for (int s = -4; s <= 5; ++s) {
      if (sad(s) < sad(shift)) { shift = s; }
    }
    if (shift == -5 || shift == 5) { return none; }
    auto const d1 = static_cast<float>(sad(shift - 1));
    auto const d2 = static_cast<float>(sad(shift));
    auto const d3 = static_cast<float>(sad(shift + 1));
    float const delta = (d1 - d3) / product(2.0f, d1 + d3 - product(2.0f, d2));
    if (!(delta >= -1 && delta <= 1)) { return none; }
    float u =
        product(g_.scale[k.octave], static_cast<float>(ur) + static_cast<float>(shift) + delta);
    float disparity = k.x - u;
    if (!(disparity >= 0 && disparity < max_disparity_)) { return none; }
    if (disparity <= 0) {
      disparity = 0.01f;
      u = k.x - 0.01f;
    }
    return {u, bf_ / disparity, sad(shift)};
  }
  int at(std::vector<std::uint8_t> const& slab, int l, int x, int y) const {
    return slab.at(
        static_cast<std::size_t>(g_.offset[l] + static_cast<std::ptrdiff_t>(y) * g_.stride[l] + x));
  }

  ft::pyramid_geometry g_;
  std::vector<std::uint8_t> left_;
  std::vector<std::uint8_t> right_;
  float bf_;
  float max_disparity_;
};

template <typename Backend>
class stereo_unit : public test::on_backend<Backend> {
protected:
  using exec_type = typename Backend::exec_type;
  static constexpr ft::memory_space space = exec_type::space;
  Backend backend;
  ft::stereo_params params{12.8f, 64.0f, 75};

  ft::orb_extractor<exec_type> extractor(int pairs) {
    ft::orb_params p;
    p.width = width;
    p.height = height;
    p.features = 500;
    return ft::orb_extractor<exec_type>(backend.exec, p, 2 * pairs);
  }
  void extract(ft::orb_extractor<exec_type>& orb, std::vector<image> const& images) {
    for (std::size_t i = 0; i < images.size(); ++i) {
      orb.upload(backend.exec, static_cast<int>(i), {images[i].data(), width, height, width});
      backend.exec.wait();
    }
    orb.extract(backend.exec);
    backend.exec.wait();
  }

  /// Matches of all pairs, [pair][keypoint].
  std::vector<std::vector<match>> run(ft::image_pyramid_view const& pyramid,
                                      ft::keypoints_view const& kp) {
    auto const& exec = backend.exec;
    int const pairs = kp.batch / 2;
    ft::stereo_matches<space> const out(kp.capacity, pairs);
    ft::grid_geometry rows;
    rows.cols = 1;
    rows.rows = height;
    ft::feature_grid<space> const grid(rows, kp.capacity, pairs);
    ft::match_stereo_rectified(exec, pyramid, kp, params, out.view(), grid.view());
    auto const x = test::column<ft::field::right_x>(exec, out.view());
    auto const depth = test::column<ft::field::depth>(exec, out.view());
    auto const score = test::column<ft::field::score>(exec, out.view());
    auto const rival = test::column<ft::field::rival>(exec, out.view());
    auto const rows_apart = test::column<ft::field::row_difference>(exec, out.view());
    auto const count = test::from_exec(exec, static_cast<int const*>(out.view().count),
                                       static_cast<std::size_t>(pairs));
    std::vector<std::vector<match>> all(static_cast<std::size_t>(pairs));
    for (std::size_t p = 0; p < all.size(); ++p) {
      for (int i = 0; i < kp.capacity; ++i) {
        std::size_t const at =
            p * static_cast<std::size_t>(kp.capacity) + static_cast<std::size_t>(i);
        if (i < count[p]) {
          bool const is = depth[at] > 0;
          all[p].push_back(
              {x[at], depth[at], score[at], is ? rival[at] : 0, is ? rows_apart[at] : 0.0f});
        } else {
          EXPECT_EQ(x[at], -1) << "entries without a keypoint are no match";
          EXPECT_EQ(depth[at], -1);
          EXPECT_EQ(score[at], -1);
        }
      }
    }
    return all;
  }

  std::vector<keypoint> keypoints_of(ft::keypoints_view const& kp, int b) {
    auto const& exec = backend.exec;
    auto const n = static_cast<std::size_t>(
        test::from_exec(exec, static_cast<int const*>(kp.count),
                        static_cast<std::size_t>(kp.batch))[static_cast<std::size_t>(b)]);
    auto const s = kp.slice(b);
    auto const x = test::column<ft::field::x>(exec, s);
    auto const y = test::column<ft::field::y>(exec, s);
    auto const octave = test::column<ft::field::octave>(exec, s);
    auto const orb = test::column<ft::field::orb>(exec, s);
    std::vector<keypoint> all;
    for (std::size_t i = 0; i < n; ++i) { all.push_back({x[i], y[i], octave[i], orb[i]}); }
    return all;
  }
  std::vector<std::uint8_t> slab_of(ft::image_pyramid_view const& p, int b) {
    return test::from_exec(backend.exec,
                           static_cast<std::uint8_t const*>(p.data) + b * p.geometry.bytes,
                           static_cast<std::size_t>(p.geometry.bytes));
  }

  /// Keypoints made by hand, left and right.
  ft::keypoints<space> upload(std::vector<keypoint> const& left, std::vector<keypoint> const& right,
                              int capacity) {
    ft::keypoints<ft::memory_space::host> const staging(capacity, 2);
    auto const put = [&](int b, std::vector<keypoint> const& all) {
      auto const s = staging.view().slice(b);
      *s.count = static_cast<int>(all.size());
      for (int i = 0; i < capacity; ++i) {
        keypoint const k =
            i < *s.count ? all[static_cast<std::size_t>(i)] : keypoint{50, 50, 0, {}};
        s.x(i) = k.x;
        s.y(i) = k.y;
        s.angle(i) = 0;
        s.response(i) = 0;
        s.octave(i) = k.octave;
        s.orb(i) = k.orb;
      }
    };
    put(0, left);
    put(1, right);
    ft::keypoints<space> kp(capacity, 2);
    ft::copy(backend.exec, kp.view(), staging.view());
    backend.exec.wait();
    return kp;
  }
};
TYPED_TEST_SUITE(stereo_unit, test::backends);

TYPED_TEST(stereo_unit, finds_the_shift_of_shifted_images) {
  std::vector<int> const shifts{3, 12, 40};
  std::vector<image> images;
  for (std::size_t i = 0; i < shifts.size(); ++i) {
    auto views = shifted_pair(shifts[i], static_cast<unsigned>(50 + i));
    images.push_back(std::move(views.first));
    images.push_back(std::move(views.second));
  }
  auto orb = this->extractor(3);
  this->extract(orb, images);
  auto const all = this->run(orb.pyramid(), orb.keypoints());
  for (std::size_t p = 0; p < shifts.size(); ++p) {
    auto const left = this->keypoints_of(orb.keypoints(), static_cast<int>(2 * p));
    ASSERT_EQ(all[p].size(), left.size());
    int matched = 0;
    int right = 0;
    for (std::size_t i = 0; i < left.size(); ++i) {
      if (all[p][i].depth < 0) { continue; }
      ++matched;
      float const disparity = left[i].x - all[p][i].right_x;
      EXPECT_NEAR(all[p][i].depth * disparity, this->params.bf, 1e-3f);
      // The level's pixel, at most.
      right += static_cast<int>(std::abs(disparity - static_cast<float>(shifts[p])) <
                                orb.geometry().scale[left[i].octave]);
    }
    EXPECT_GT(matched, static_cast<int>(left.size()) / 2) << "shift " << shifts[p];
    EXPECT_GT(right, matched * 95 / 100) << "shift " << shifts[p];
  }
}

TYPED_TEST(stereo_unit, agrees_with_the_definition) {
  std::vector<image> images;
  for (unsigned i = 0; i < 3; ++i) {
    auto views = shifted_pair(5 + 13 * static_cast<int>(i), 60 + i);
    // Noise and another brightness on the right, so that distances and refinements vary.
    std::mt19937 random(i);
    for (auto& p : views.second) {
      p = static_cast<std::uint8_t>(std::min(255, p + static_cast<int>(random() % 13u)));
    }
    images.push_back(std::move(views.first));
    images.push_back(std::move(views.second));
  }
  auto orb = this->extractor(3);
  this->extract(orb, images);
  auto const all = this->run(orb.pyramid(), orb.keypoints());
  int matched = 0;
  int unmatched = 0;
  for (int p = 0; p < 3; ++p) {
    plain_matcher const plain(orb.geometry(), this->slab_of(orb.pyramid(), 2 * p),
                              this->slab_of(orb.pyramid(), 2 * p + 1), this->params.bf,
                              this->params.max_disparity);
    auto const want = plain.run(this->keypoints_of(orb.keypoints(), 2 * p),
                                this->keypoints_of(orb.keypoints(), 2 * p + 1));
    auto const& got = all[static_cast<std::size_t>(p)];
    ASSERT_EQ(got.size(), want.size());
    for (std::size_t i = 0; i < want.size(); ++i) {
      EXPECT_EQ(got[i].right_x, want[i].right_x) << "pair " << p << " keypoint " << i;
      EXPECT_EQ(got[i].depth, want[i].depth);
      EXPECT_EQ(got[i].score, want[i].score);
      (want[i].score >= 0 ? matched : unmatched) += 1;
    }
  }
  EXPECT_GT(matched, 200);
  EXPECT_GT(unmatched, 50);
}

TYPED_TEST(stereo_unit, pairs_without_keypoints_on_a_side) {
  // Pair 0 has no right keypoints, pair 1 no left ones, pair 2 none at all.
  auto const views = shifted_pair(10, 70);
  image const flat(static_cast<std::size_t>(width * height), 100);
  auto orb = this->extractor(3);
  this->extract(orb, {views.first, flat, flat, views.second, flat, flat});
  auto const all = this->run(orb.pyramid(), orb.keypoints());
  EXPECT_GT(all[0].size(), 100u);
  for (auto const& m : all[0]) {
    EXPECT_EQ(m.right_x, -1);
    EXPECT_EQ(m.depth, -1);
    EXPECT_EQ(m.score, -1);
  }
  EXPECT_TRUE(all[1].empty());
  EXPECT_TRUE(all[2].empty());
}

TYPED_TEST(stereo_unit, descriptors_too_far_apart_do_not_match) {
  auto views = shifted_pair(10, 71);
  // Another brightness: a median of 0 would cut every match.
  for (auto& p : views.second) { p = static_cast<std::uint8_t>(std::min(255, p + 3)); }
  auto orb = this->extractor(1);
  this->extract(orb, {views.first, views.second});
  // One pair of points, 74 and 75 bits apart: the limit is strict. Both images show the same there.
  keypoint const left = this->keypoints_of(orb.keypoints(), 0)[0];
  for (int bits : {0, 74, 75, 200}) {
    keypoint right = left;
    right.x = left.x - 10;
    for (int b = 0; b < bits; ++b) { right.orb.words[b / 32] ^= 1u << (b % 32); }
    auto const kp = this->upload({left}, {right}, 4);
    auto const all = this->run(orb.pyramid(), kp.view());
    ASSERT_EQ(all[0].size(), 1u);
    EXPECT_EQ(all[0][0].depth > 0, bits < 75) << bits;
  }
}

TYPED_TEST(stereo_unit, how_far_rows_are_apart_is_told) {
  auto views = shifted_pair(10, 72);
  for (auto& p : views.second) { p = static_cast<std::uint8_t>(std::min(255, p + 3)); }
  auto orb = this->extractor(1);
  this->extract(orb, {views.first, views.second});
  keypoint const left{150, 100, 0, {{1, 2, 3, 4, 5, 6, 7, 8}}};
  for (float y : {100.0f, 101.5f, 97.75f, 102.0f}) {
    keypoint right = left;
    right.x = 140;
    right.y = y;
    auto const kp = this->upload({left}, {right}, 4);
    auto const all = this->run(orb.pyramid(), kp.view());
    ASSERT_GT(all[0][0].depth, 0) << y;
    EXPECT_EQ(all[0][0].rows, y - 100) << y;
  }
}

TYPED_TEST(stereo_unit, rows_that_repeat_are_told) {
  auto views = shifted_pair(10, 71);
  for (auto& p : views.second) { p = static_cast<std::uint8_t>(std::min(255, p + 3)); }
  auto orb = this->extractor(1);
  this->extract(orb, {views.first, views.second});
  keypoint left{150, 100, 0, {{1, 2, 3, 4, 5, 6, 7, 8}}};
  keypoint right = left;
  right.x = 140;
  right.orb.words[0] ^= 7u;  // 3 bits
  struct row {
    float x, y;
    int octave, bits;
    bool rival;
  };
  for (row const& r : {row{120, 100, 0, 10, true}, row{120, 100, 0, 11, false},  // 7 bits more, 8
                       row{129, 100, 0, 3, true}, row{130, 100, 0, 3, false},    // 11 pixels, 10
                       row{120, 100, 2, 3, false}, row{120, 110, 0, 3, false},   // not of its rows
                       row{160, 100, 0, 3, false}}) {                            // behind infinity
    keypoint other = left;
    other.x = r.x;
    other.y = r.y;
    other.octave = r.octave;
    for (int b = 0; b < r.bits; ++b) { other.orb.words[1 + b / 32] ^= 1u << (b % 32); }
    auto const kp = this->upload({left}, {right, other}, 4);
    auto const all = this->run(orb.pyramid(), kp.view());
    ASSERT_GT(all[0][0].depth, 0);
    EXPECT_EQ(all[0][0].rival, r.rival ? 1 : 0) << r.x << " " << r.y << " " << r.bits;
  }
}

TYPED_TEST(stereo_unit, keypoints_at_the_rim_read_nothing_outside) {
  auto const views = shifted_pair(0, 72);
  auto orb = this->extractor(1);
  this->extract(orb, {views.first, views.second});
  ft::descriptor const same{{1, 2, 3, 4, 5, 6, 7, 8}};
  float const nan = std::numeric_limits<float>::quiet_NaN();
  std::vector<keypoint> all;
  for (int octave = 0; octave < 8; ++octave) {
    for (float const x :
         {0.0f, 0.4f, 4.9f, 5.0f, 160.0f, 314.0f, 315.0f, 319.0f, 319.9f, 500.0f, -3.0f, nan}) {
      for (float const y :
           {0.0f, 4.9f, 5.0f, 100.0f, 194.0f, 195.0f, 199.0f, 199.9f, 200.0f, -1.0f, nan}) {
        all.push_back({x, y, octave, same});
      }
    }
  }
  auto const n = static_cast<int>(all.size());
  auto const kp = this->upload(all, all, n);
  auto const got = this->run(orb.pyramid(), kp.view());
  ASSERT_EQ(got[0].size(), all.size());
  for (std::size_t i = 0; i < all.size(); ++i) {
    float const disparity = all[i].x - got[0][i].right_x;
    EXPECT_TRUE(got[0][i].depth == -1 || (disparity >= 0 && disparity < this->params.max_disparity))
        << i;
    bool const outside = !(all[i].x >= 5 && all[i].x <= 315 && all[i].y >= 5 && all[i].y <= 195);
    if (outside) { EXPECT_EQ(got[0][i].depth, -1) << all[i].x << ", " << all[i].y; }
  }
}

TYPED_TEST(stereo_unit, outliers_are_cut_at_the_median) {
  auto const& exec = this->backend.exec;
  struct distribution {
    int count, low, high, unmatched_of_10;
  };
  // None, one, two; all equal, also the largest sum of a patch (11 * 11 * 510) and the largest
  // score of all; more than every thread keeps (3 * 512); medians at either end of a bin of 64.
  std::vector<distribution> const pairs{{0, 0, 1, 0},
                                        {1, 500, 500, 0},
                                        {1, 0, 0, 0},
                                        {2, 0, 30855, 0},
                                        {2, 61710, 65535, 0},
                                        {3, 0, 65535, 0},
                                        {7, 3, 3, 0},
                                        {50, 0, 0, 0},
                                        {400, 0, 255, 3},
                                        {1000, 0, 30855, 5},
                                        {999, 200, 300, 1},
                                        {1000, 250, 520, 9},
                                        {300, 0, 30855, 10},
                                        {1000, 30855, 30855, 0},
                                        {513, 0, 2000, 2},
                                        {1535, 0, 9000, 0},
                                        {1536, 0, 9000, 1},
                                        {1537, 0, 9000, 0},
                                        {2000, 63, 64, 0},
                                        {2000, 127, 192, 2},
                                        {4000, 0, 61710, 4},
                                        {5000, 0, 65535, 0},
                                        {5000, 0, 700, 2},
                                        {5000, 61710, 61710, 1},
                                        {4999, 65535, 65535, 0},
                                        {5000, 0, 65535, 10},
                                        {5000, 29000, 62000, 3}};
  constexpr int capacity = 5000;
  int const batch = static_cast<int>(pairs.size());
  ft::stereo_matches<ft::memory_space::host> const staging(capacity, batch);
  std::mt19937 random(5);
  for (int b = 0; b < batch; ++b) {
    auto const s = staging.view().slice(b);
    auto const& d = pairs[static_cast<std::size_t>(b)];
    *s.count = d.count;
    for (int i = 0; i < capacity; ++i) {
      // Entries beyond the count would change the median if they were read.
      bool const matched = i >= d.count || static_cast<int>(random() % 10u) >= d.unmatched_of_10;
      double const u = static_cast<double>(random() % 10001u) / 10000.0;
      int const score =
          d.low + static_cast<int>(u * u * (d.high - d.low));  // most are low, some far above
      s.score(i) = matched ? score : -1;
      s.right_x(i) = matched ? static_cast<float>(i) : -1.0f;
      s.depth(i) = matched ? static_cast<float>(i + 1) : -1.0f;
    }
  }
  auto const cut = [&](auto shape) {
    ft::stereo_matches<TestFixture::space> const matches(capacity, batch);
    ft::copy(exec, matches.view(), staging.view());
    exec.wait();
    ft::for_each_item<decltype(shape)>(exec, batch, ft::detail::cut_stereo_outliers{},
                                       matches.view());
    auto const score = test::column<ft::field::score>(exec, matches.view());
    auto const x = test::column<ft::field::right_x>(exec, matches.view());
    auto const depth = test::column<ft::field::depth>(exec, matches.view());
    int dropped = 0;
    int past_kept = 0;
    for (int b = 0; b < batch; ++b) {
      auto const s = staging.view().slice(b);
      std::vector<int> scores;
      for (int i = 0; i < *s.count; ++i) {
        if (s.score(i) >= 0) { scores.push_back(s.score(i)); }
      }
      float limit = 1e30f;
      if (!scores.empty()) {
        auto const middle = scores.begin() + static_cast<std::ptrdiff_t>(scores.size() / 2);
        std::nth_element(scores.begin(), middle, scores.end());
        limit = product(1.5f * 1.4f, static_cast<float>(*middle));
      }
      for (int i = 0; i < capacity; ++i) {
        auto const at = static_cast<std::size_t>(b * capacity + i);
        bool const drop = i < *s.count && static_cast<float>(s.score(i)) >= limit;
        ASSERT_EQ(score[at], drop ? -1 : s.score(i)) << "pair " << b << " entry " << i;
        ASSERT_EQ(x[at], drop ? -1 : s.right_x(i));
        ASSERT_EQ(depth[at], drop ? -1 : s.depth(i));
        dropped += static_cast<int>(drop);
        past_kept += static_cast<int>(drop && i >= 3 * 512);
      }
    }
    EXPECT_GT(dropped, 300);
    EXPECT_GT(past_kept, 300);
  };
  cut(ft::per_block<512>{});  // as the matcher does
  cut(ft::per_block<256>{});
  cut(ft::per_block<1024>{});
}

/// By squares and by rotations, of a symmetric matrix each.
struct find_eigenvectors {
  using scratch = ft::no_scratch;
  template <typename Group>
  FT_HOST_DEVICE void operator()(Group, scratch&, int item, double const* matrices, int* by_squares,
                                 double* squares, double* rotations) const {
    ft::detail::symmetric_4 upper;
    ft::strict_double full[4][4];
    for (int i = 0; i < 4; ++i) {
      for (int j = 0; j < 4; ++j) {
        full[i][j] = matrices[16 * item + 4 * i + j];
        if (j >= i) { upper.m[i][j] = full[i][j]; }
      }
    }
    ft::strict_double v[4] = {0.0, 0.0, 0.0, 0.0};
    by_squares[item] = static_cast<int>(ft::detail::smallest_eigenvector_by_squares(upper, v));
    for (int i = 0; i < 4; ++i) { squares[4 * item + i] = v[i].value; }
    ft::detail::smallest_eigenvector_4(full, v);
    for (int i = 0; i < 4; ++i) { rotations[4 * item + i] = v[i].value; }
  }
};

TYPED_TEST(stereo_unit, lowest_eigenvectors_agree_in_both_ways) {
  std::mt19937_64 random(41);
  std::normal_distribution<double> normal;
  constexpr int n = 4000;
  std::vector<double> matrices;
  for (int t = 0; t < n; ++t) {
    // Rows as of triangulation: three directions, and a column as small as the baseline. Some have
    // an exact answer, some are so near to a second one that rounding shows.
    double rows[4][4];
    bool const doubtful = t % 8 == 7;
    double const baseline = std::pow(10.0, -2.0 * (t % 5) / 4);
    double const noise = t % 3 == 0 ? 0.0 : std::pow(10.0, -4.0 + t % 4);
    double point[4];
    for (double& p : point) { p = normal(random); }
    for (auto& row : rows) {
      for (double& r : row) { r = normal(random); }
      if (doubtful) {
        row[1] = row[0] + 1e-4 * row[1];
        row[3] = row[2] + 1e-4 * row[3];
        continue;
      }
      row[3] *= baseline;
      double along = 0;
      double length = 0;
      for (int i = 0; i < 4; ++i) {
        along += row[i] * point[i];
        length += point[i] * point[i];
      }
      for (int i = 0; i < 4; ++i) {
        row[i] += -along / length * point[i] + noise * baseline * normal(random);
      }
    }
    for (int i = 0; i < 4; ++i) {
      for (int j = 0; j < 4; ++j) {
        double sum = 0;
        for (auto const& row : rows) { sum += row[i] * row[j]; }
        matrices.push_back(sum);
      }
    }
  }
  // Without an answer, or with several.
  for (double diagonal : {0.0, 1.0}) {
    for (int i = 0; i < 16; ++i) { matrices.push_back(i % 5 == 0 ? diagonal : 0.0); }
  }
  constexpr std::size_t all = n + 2;
  auto const& exec = this->backend.exec;
  ft::buffer<double, TestFixture::space> input(16 * all);
  ft::buffer<double, TestFixture::space> output(8 * all);
  ft::buffer<int, TestFixture::space> ways(all);
  ft::copy(exec, input.data(), static_cast<double const*>(matrices.data()), matrices.size());
  ft::for_each_item<ft::per_thread>(exec, static_cast<int>(all), find_eigenvectors{},
                                    static_cast<double const*>(input.data()), ways.data(),
                                    output.data(), output.data() + 4 * all);
  std::vector<int> by_squares(all);
  std::vector<double> found(8 * all);
  ft::copy(exec, by_squares.data(), static_cast<int const*>(ways.data()), all);
  ft::copy(exec, found.data(), static_cast<double const*>(output.data()), 8 * all);
  exec.wait();
  int refused = 0;
  for (std::size_t t = 0; t < n; ++t) {
    refused += static_cast<int>(by_squares[t] == 0);
    if (by_squares[t] == 0) { continue; }
    double const* const a = found.data() + 4 * t;
    double const* const b = found.data() + 4 * (all + t);
    double aa = 0, bb = 0, ab = 0;
    for (int i = 0; i < 4; ++i) {
      aa += a[i] * a[i];
      bb += b[i] * b[i];
      ab += a[i] * b[i];
    }
    double apart = 0;
    for (int i = 0; i < 4; ++i) {
      apart = std::max(apart, std::abs(a[i] / std::sqrt(aa) - b[i] * ab / std::sqrt(aa) / bb));
    }
    EXPECT_LT(apart, 1e-8) << "matrix " << t;
  }
  EXPECT_GT(refused, 0) << "the rotations are needed, too";
  EXPECT_LT(refused, n / 4);
  EXPECT_EQ(by_squares[n], 0);
  EXPECT_EQ(by_squares[n + 1], 0);
}

}  // namespace stereo_test
