// SPDX-License-Identifier: Apache-2.0
// The images of a batch in parts: the keypoints and grids of the whole.
#include <gtest/gtest.h>

#include <algorithm>
#include <cstddef>
#include <cstdint>
#include <string>
#include <vector>

#include "ft/containers/feature_grid.hpp"
#include "ft/core/execution.hpp"
#include "ft/core/stage_clock.hpp"
#include "ft/pipelines/detail/extraction.hpp"
#include "ft/pipelines/detail/frame_schedule.hpp"
#include "ft/pipelines/orb_extractor.hpp"
#include "tests/support/backends.hpp"
#include "tests/support/random.hpp"

namespace extractor_parts_test {

constexpr int w = 200;
constexpr int h = 150;
constexpr int images = 6;

template <typename Backend>
class extractor_parts : public test::on_backend<Backend> {};
TYPED_TEST_SUITE(extractor_parts, test::backends);

/// Finds the keypoints of images from `first` on, as a batch of frames in parts does.
template <typename Exec>
void find_in_part(Exec const& exec, ft::detail::extraction<Exec> const& whole, int first, int count,
                  ft::feature_grid_view const& cells) {
  using grids_type = ft::keypoint_grids<false>;
  ft::detail::extraction_with<Exec, grids_type> const part{whole.part(first, count), nullptr,
                                                           grids_type{cells, {}}.from(first)};
  part.build_levels(exec);
  ft::stage_clock<Exec> untimed;
  ft::detail::stage_line<Exec> line(exec, untimed);
  ft::detail::queue_features(line, part);
  exec.wait();
}

/// Everything that an image yields.
struct found {
  int count = 0, mono = 0;
  std::vector<float> x, y, angle, response;
  std::vector<int> octave;
  std::vector<ft::descriptor> orb;
  std::vector<int> starts;  ///< of the grid's cells
};
template <typename Exec>
std::vector<found> all_of(Exec const& exec, ft::orb_extractor<Exec> const& e,
                          ft::feature_grid_view const& cells) {
  auto const counts = test::from_exec(exec, static_cast<int const*>(e.keypoints().count), images);
  auto const mono = test::from_exec(exec, e.mono_count(), images);
  std::vector<found> all(images);
  for (int i = 0; i < images; ++i) {
    auto const k = e.keypoints().slice(i);
    found& f = all[static_cast<std::size_t>(i)];
    f.count = counts[static_cast<std::size_t>(i)];
    f.mono = mono[static_cast<std::size_t>(i)];
    auto const n = static_cast<std::size_t>(f.count);
    auto const first = [&](auto values) {
      values.resize(n);
      return values;
    };
    f.x = first(test::column<ft::field::x>(exec, k));
    f.y = first(test::column<ft::field::y>(exec, k));
    f.angle = first(test::column<ft::field::angle>(exec, k));
    f.response = first(test::column<ft::field::response>(exec, k));
    f.octave = first(test::column<ft::field::octave>(exec, k));
    f.orb = first(test::column<ft::field::orb>(exec, k));
    f.starts = test::from_exec(exec, static_cast<int const*>(cells.slice(i).start),
                               static_cast<std::size_t>(cells.geometry.cells() + 1));
  }
  return all;
}

TYPED_TEST(extractor_parts, give_what_the_whole_gives) {
  TypeParam backend;
  auto const& exec = backend.exec;
  using exec_type = typename TypeParam::exec_type;
  ft::orb_params params;
  params.width = w;
  params.height = h;
  params.features = 300;
  params.mask_width = 20;
  params.mask_height = 15;
  params.corner_ratio = 0.1f;
  params.refine_positions = true;
  std::vector<std::uint8_t> left_half(20 * 15, 0);
  for (std::size_t k = 0; k < left_half.size(); ++k) { left_half[k] = k % 20 < 10 ? 255 : 0; }
  std::vector<ft::stereo_overlap> overlaps;
  for (int i = 0; i < images; ++i) { overlaps.push_back({30.0f * static_cast<float>(i), w}); }
  ft::absent_images const second_of_three{0b010, 3};
  ft::orb_extractor<exec_type> whole(exec, params, images, overlaps, second_of_three);
  ft::orb_extractor<exec_type> other(exec, params, images, overlaps, second_of_three);
  for (auto* const e : {&whole, &other}) {
    e->set_mask(exec, 3, {left_half.data(), 20, 15, 20});
    for (int i : {0, 2, 3, 5}) {
      auto const pixels = test::random_image(w, h, 20 + static_cast<unsigned>(i));
      e->upload(exec, i, {pixels.data(), w, h, w});
      exec.wait();
    }
  }
  auto const geometry = ft::grid_geometry::over(0, 0, w, h);
  ft::feature_grid<exec_type::space> const at_once(geometry, whole.capacity(), images);
  ft::feature_grid<exec_type::space> const in_parts(geometry, whole.capacity(), images);
  find_in_part(exec, whole.stages(), 0, images, at_once.view());
  find_in_part(exec, other.stages(), 3, 3, in_parts.view());
  find_in_part(exec, other.stages(), 0, 3, in_parts.view());
  auto const expected = all_of(exec, whole, at_once.view());
  auto const seen = all_of(exec, other, in_parts.view());
  for (std::size_t i = 0; i < images; ++i) {
    SCOPED_TRACE("image " + std::to_string(i));
    ASSERT_EQ(seen[i].count, expected[i].count);
    EXPECT_EQ(seen[i].mono, expected[i].mono);
    EXPECT_EQ(seen[i].x, expected[i].x);
    EXPECT_EQ(seen[i].y, expected[i].y);
    EXPECT_EQ(seen[i].angle, expected[i].angle);
    EXPECT_EQ(seen[i].response, expected[i].response);
    EXPECT_EQ(seen[i].octave, expected[i].octave);
    EXPECT_EQ(seen[i].starts, expected[i].starts);
    EXPECT_TRUE(std::equal(seen[i].orb.begin(), seen[i].orb.end(), expected[i].orb.begin(),
                           [](auto const& a, auto const& b) { return ft::hamming(a, b) == 0; }));
    EXPECT_EQ(expected[i].count > 50, i % 3 != 1) << "absent ones have none";
  }
  EXPECT_LT(*std::max_element(expected[3].x.begin(), expected[3].x.end()), 110) << "the mask";
  EXPECT_GT(expected[5].mono, 0);
}

}  // namespace extractor_parts_test
