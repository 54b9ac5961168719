// SPDX-License-Identifier: Apache-2.0
// Stages that exist for wide vectors and without them, on the host: the same results from both. The
// other tests run the one that suits the processor.
#include <gtest/gtest.h>

#include <cstddef>
#include <cstdint>
#include <cstring>
#include <random>
#include <vector>

#include "ft/containers/image_pyramid.hpp"
#include "ft/containers/remap_table.hpp"
#include "ft/containers/vocabulary.hpp"
#include "ft/containers/words.hpp"
#include "ft/kernels/images/rectify.hpp"
#include "ft/kernels/words/transform.hpp"
#include "ft/pipelines/orb_extractor.hpp"
#include "ft/pipelines/pose_graph.hpp"
#include "tests/support/backends.hpp"
#include "tests/support/plain_vocabulary.hpp"
#include "tests/support/pose_graphs.hpp"
#include "tests/support/random.hpp"

namespace wide_test {

using extractor = ft::orb_extractor<ft::host_exec>;
using bytes = std::vector<unsigned char>;

enum class version { plain, wide };

template <typename Op, typename... Args>
void run(version v, int items, Op const& op, Args const&... args) {
  for (int i = 0; i < items; ++i) {
    if (v == version::wide) {
      ft::detail::run_wide(op, i, args...);
    } else {
      ft::detail::run_plain(op, i, args...);
    }
  }
}

template <typename T>
void append(bytes& to, T const* from, std::size_t count) {
  auto const* const p = reinterpret_cast<unsigned char const*>(from);
  to.insert(to.end(), p, p + count * sizeof(T));
}
void append_pixels(bytes& to, ft::image_pyramid_view const& pyramid) {
  for (int image = 0; image < pyramid.batch; ++image) {
    for (int l = 0; l < pyramid.geometry.levels; ++l) {
      auto const level = pyramid.level(image, l);
      for (int y = 0; y < level.height; ++y) {
        append(to, level.row(y), static_cast<std::size_t>(level.width));
      }
    }
  }
}

class wide_stages : public ::testing::Test {
protected:
  void SetUp() override {
    if (!ft::detail::has_wide_vectors() || !FT_HAS_WIDE) {
      GTEST_SKIP() << "one version only: built for this processor, or it has no wide vectors";
    }
  }

  /// Everything that the stages of extraction leave, each run by `v` alone.
  static bytes extract(version v, extractor& orb) {
    ft::host_exec const exec(1);
    auto const pyramid = orb.pyramid();
    auto const blurred = orb.blurred();
    auto const corners = orb.corners();
    auto const kept = orb.distribution();
    auto const keypoints = orb.keypoints();
    auto const& g = orb.geometry();
    std::vector<ft::resize_tap> taps(static_cast<std::size_t>(g.taps));
    ft::make_resize_taps(g, taps.data());
    auto const blur = ft::blur_layout::make(g);
    auto const b = static_cast<std::size_t>(pyramid.batch);
    std::vector<int> place(b * static_cast<std::size_t>(kept.layout.total));
    std::vector<int> mono(b);
    std::vector<ft::stereo_overlap> const overlaps(b);

    for (int l = 1; l < g.levels; ++l) {
      run(v, pyramid.batch * ft::detail::resize_band::bands(g, l), ft::detail::resize_band{},
          pyramid, static_cast<ft::resize_tap const*>(taps.data()), l);
    }
    run(v, pyramid.batch * blur.first[blur.levels], ft::detail::blur_tile{}, pyramid, blurred,
        blur);
    run(v, corners.batch * ft::detail::detect_strip::strips(corners.layout),
        ft::detail::detect_strip{}, pyramid, corners, ft::corner_params{});
    ft::distribute_corners(exec, corners, kept);
    run(version::plain, pyramid.batch, ft::detail::order_image<ft::detail::no_filler>{},
        ft::ordering_view{g, kept, overlaps.data(), keypoints, mono.data(), place.data(), {}});
    run(v, pyramid.batch * kept.layout.total, ft::detail::describe_corner{},
        ft::describing_view{
            {pyramid, blurred, ft::orb_pattern}, kept, place.data(), keypoints, {}, nullptr});

    bytes all;
    append_pixels(all, pyramid);
    append_pixels(all, blurred);
    for (int image = 0; image < pyramid.batch; ++image) {
      auto const of_image = keypoints.slice(image);
      auto const n = static_cast<std::size_t>(*of_image.count);
      EXPECT_GT(n, 20u);
      append(all, of_image.count, 1);
      append(all, ft::array_of<ft::field::x>(of_image), n);
      append(all, ft::array_of<ft::field::y>(of_image), n);
      append(all, ft::array_of<ft::field::angle>(of_image), n);
      append(all, ft::array_of<ft::field::response>(of_image), n);
      append(all, ft::array_of<ft::field::octave>(of_image), n);
      append(all, ft::array_of<ft::field::orb>(of_image), n);
    }
    return all;
  }
};

TEST_F(wide_stages, of_extraction_give_the_same_bytes_in_both_versions) {
  ft::host_exec const exec(1);
  struct shape {
    int w, h, levels;
    float factor;
  };
  for (shape const s : {shape{752, 480, 8, 1.2f}, shape{333, 257, 4, 1.3f}, shape{131, 97, 2, 2.0f},
                        shape{70, 210, 3, 1.1f}}) {
    ft::orb_params params;
    params.width = s.w;
    params.height = s.h;
    params.levels = s.levels;
    params.scale_factor = s.factor;
    params.features = 600;
    extractor orb(exec, params, 2);
    for (int i = 0; i < 2; ++i) {
      auto const pixels = test::random_image(s.w, s.h, static_cast<unsigned>(s.w + i));
      orb.upload(exec, i, {pixels.data(), s.w, s.h, s.w});
    }
    EXPECT_TRUE(extract(version::plain, orb) == extract(version::wide, orb)) << s.w << "x" << s.h;
  }
}

TEST_F(wide_stages, of_rectification_give_the_same_bytes_in_both_versions) {
  constexpr int w = 201;
  constexpr int h = 67;
  std::mt19937 random(8);
  auto const from = test::random_image(w, h, 3);
  ft::remap_table<ft::memory_space::host> const table({w, h, w, h});
  for (int i = 0; i < w * h; ++i) {
    // Rows that stay inside, rows that leave, rows that are anywhere.
    int const kind = i / w % 3;
    int const reach = kind == 0 ? 0 : kind == 1 ? 3 : 400;
    auto const near = [&](int at, int n) {
      int const off =
          reach == 0 ? 0 : static_cast<int>(random() % (2u * static_cast<unsigned>(reach))) - reach;
      return static_cast<std::int16_t>(kind == 0 ? at * (n - 1) / n : at + off);
    };
    table.view().position[i] = {near(i % w, w), near(i / w, h)};
    table.view().fraction[i] = static_cast<std::uint16_t>(random() % 1024u);
  }
  bytes results[2];
  for (version const v : {version::plain, version::wide}) {
    bytes& to = results[v == version::wide];
    to.assign(w * h, 0);
    run(v, h, ft::detail::rectify_row{},
        ft::image_batch_view<std::uint8_t const>{from.data(), w, h, w, 0, 1}, table.view(),
        ft::image_batch_view<std::uint8_t>{to.data(), w, h, w, 0, 1}, std::uint8_t{17});
  }
  EXPECT_TRUE(results[0] == results[1]);
}

TEST_F(wide_stages, of_words_give_the_same_in_both_versions) {
  test::generator random(9);
  auto const v = test::random_vocabulary(random, 10, 4, 10);
  auto const made = ft::make_vocabulary(v.arrays());
  int count = 500;
  std::vector<ft::descriptor> rows;
  for (int i = 0; i < count; ++i) {
    rows.push_back(random.flipped(v.orb[test::at(random.below(v.nodes()))], random.below(60)));
  }
  ft::descriptors_view in;
  static_cast<ft::column<ft::field::orb>&>(in).data = rows.data();
  in.capacity = count;
  in.batch = 1;
  in.count = &count;
  auto const carve_words = [&](ft::carver& c, ft::feature_words_view& o) { carve(c, o, 1, count); };
  ft::owner<ft::feature_words_view, ft::memory_space::host> const plain(carve_words);
  ft::owner<ft::feature_words_view, ft::memory_space::host> const wide(carve_words);
  run(version::plain, count, ft::detail::find_word{2}, made.view(), in, plain.view());
  run(version::wide, count, ft::detail::find_word{2}, made.view(), in, wide.view());
  for (int i = 0; i < count; ++i) {
    EXPECT_EQ(plain->word[i], wide->word[i]);
    EXPECT_EQ(plain->node[i], wide->node[i]);
    EXPECT_EQ(plain->weight[i], wide->weight[i]);
  }
}

TEST_F(wide_stages, of_pose_graphs_give_the_same_bits_in_both_versions) {
  constexpr std::size_t side = 2 * ft::detail::tile_side<6>;
  test::random_motions any(5);
  std::vector<double> dense(side * side);
  std::vector<double> right(side);
  for (double& v : dense) { v = any.number(); }
  for (double& v : right) { v = any.number(); }
  auto wide_dense = dense;
  auto wide_right = right;
  ft::detail::graph_system_view<6> A;
  A.plan.dense = side / 6;
  A.dense = dense.data();
  A.right = right.data();
  auto wide = A;
  wide.dense = wide_dense.data();
  wide.right = wide_right.data();
  auto const before = dense;
  run(version::plain, 1, ft::detail::update_tiles{0}, A);
  run(version::wide, 1, ft::detail::update_tiles{0}, wide);
  EXPECT_EQ(std::memcmp(dense.data(), wide_dense.data(), dense.size() * sizeof(double)), 0);
  EXPECT_EQ(std::memcmp(right.data(), wide_right.data(), right.size() * sizeof(double)), 0);
  // Against the definition: a row of the second tile less the product of the tiles before it.
  std::size_t const r = 51;
  std::size_t const c = 49;
  double want = before[r * side + c];
  for (std::size_t m = 0; m < side / 2; ++m) {
    want -= before[r * side + m] * before[c * side + m];
  }
  EXPECT_NEAR(dense[r * side + c], want, 1e-12);
}

}  // namespace wide_test
