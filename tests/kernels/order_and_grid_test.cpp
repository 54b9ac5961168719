// SPDX-License-Identifier: Apache-2.0
// Ordering keypoints and filling their grids in one launch against the two stages one by one.
#include "ft/kernels/keypoints/order.hpp"

#include <gtest/gtest.h>

#include <cstddef>
#include <vector>

#include "ft/containers/feature_grid.hpp"
#include "ft/containers/soa.hpp"
#include "ft/kernels/grid.hpp"
#include "ft/pipelines/orb_extractor.hpp"
#include "tests/support/backends.hpp"
#include "tests/support/random.hpp"

namespace order_and_grid {

struct setup {
  int width, height, features;
  bool overlap;  ///< a part of the image
};

template <typename Backend>
class order_and_grid_unit : public test::on_backend<Backend> {
protected:
  using exec_type = typename Backend::exec_type;
  using grid = ft::feature_grid<exec_type::space>;
  static constexpr int batch = 4;
  Backend backend;

  template <bool Rectified>
  void compare(setup const& how) {
    auto const& exec = backend.exec;
    ft::orb_params params;
    params.width = how.width;
    params.height = how.height;
    params.features = how.features;
    std::vector<ft::stereo_overlap> const overlaps(
        batch, how.overlap ? ft::stereo_overlap{0.3f * static_cast<float>(how.width), 1e9f}
                           : ft::stereo_overlap{});
    ft::orb_extractor<exec_type> orb(exec, params, batch, overlaps);
    for (int i = 0; i < batch; ++i) {
      auto const image =
          test::random_image(how.width, how.height, static_cast<unsigned>(how.width + i));
      orb.upload(exec, i, {image.data(), how.width, how.height, how.width});
      exec.wait();
    }
    orb.extract(exec);
    int const capacity = orb.capacity();
    int const grids = Rectified ? batch / 2 : batch;
    auto const w = static_cast<float>(how.width);
    auto const h = static_cast<float>(how.height);
    auto const cells = ft::grid_geometry::over(0, 0, w, h);
    auto const rows = ft::grid_geometry::over(0, 0, w, h, 1, how.height);
    grid const want_cells(cells, capacity, grids), got_cells(cells, capacity, grids);
    grid const want_rows(rows, capacity, grids), got_rows(rows, capacity, grids);
    ft::build_grid<ft::nearest_cell>(exec, orb.keypoints(), 0, Rectified ? 2 : 1, grids,
                                     want_cells.view());
    if (Rectified) {
      ft::build_grid<ft::row_cell>(exec, orb.keypoints(), 1, 2, grids, want_rows.view());
    }

    ft::keypoints<exec_type::space> const keypoints(capacity, batch);
    auto const on_exec = test::to_exec(exec, overlaps);
    auto const mono = test::to_exec(exec, std::vector<int>(batch, -1));
    auto const place = test::to_exec(
        exec, std::vector<int>(static_cast<std::size_t>(batch * orb.distribution().layout.total)));
    ft::order_corners(exec,
                      ft::ordering_view{orb.geometry(),
                                        orb.distribution(),
                                        on_exec.data(),
                                        keypoints.view(),
                                        mono.data(),
                                        place.data(),
                                        {}},
                      ft::keypoint_grids<Rectified>{got_cells.view(), got_rows.view()});
    expect_same_keypoints(orb, keypoints.view(), mono.data());
    expect_same_grids(want_cells.view(), got_cells.view(), grids);
    if (Rectified) { expect_same_grids(want_rows.view(), got_rows.view(), grids); }
  }

private:
  void expect_same_keypoints(ft::orb_extractor<exec_type> const& orb, ft::keypoints_view const& got,
                             int const* mono) {
    auto const& exec = backend.exec;
    EXPECT_EQ(test::from_exec(exec, mono, batch), test::from_exec(exec, orb.mono_count(), batch));
    auto const want = orb.keypoints();
    auto const counts = test::from_exec(exec, static_cast<int const*>(want.count), batch);
    EXPECT_EQ(test::from_exec(exec, static_cast<int const*>(got.count), batch), counts);
    auto const want_x = test::column<ft::field::x>(exec, want);
    auto const got_x = test::column<ft::field::x>(exec, got);
    auto const want_octave = test::column<ft::field::octave>(exec, want);
    auto const got_octave = test::column<ft::field::octave>(exec, got);
    for (int b = 0; b < batch; ++b) {
      int const n = counts[static_cast<std::size_t>(b)];
      EXPECT_GT(n, 100);
      for (int i = 0; i < n; ++i) {
        auto const at = static_cast<std::size_t>(b * want.capacity + i);
        ASSERT_EQ(got_x[at], want_x[at]) << b << " " << i;
        ASSERT_EQ(got_octave[at], want_octave[at]) << b << " " << i;
      }
    }
  }
  void expect_same_grids(ft::feature_grid_view const& want, ft::feature_grid_view const& got,
                         int grids) {
    auto const& exec = backend.exec;
    for (int b = 0; b < grids; ++b) {
      auto const a = want.slice(b);
      auto const c = got.slice(b);
      auto const cells = static_cast<std::size_t>(a.geometry.cells());
      auto const start = test::from_exec(exec, static_cast<int const*>(a.start), cells + 1);
      ASSERT_EQ(test::from_exec(exec, static_cast<int const*>(c.start), cells + 1), start) << b;
      auto const listed = static_cast<std::size_t>(start.back());
      ASSERT_GT(listed, 0u);
      EXPECT_EQ(test::from_exec(exec, static_cast<int const*>(c.indices), listed),
                test::from_exec(exec, static_cast<int const*>(a.indices), listed))
          << b;
    }
  }
};
TYPED_TEST_SUITE(order_and_grid_unit, test::backends);

// The last case has more keypoints than a block sorts in shared memory.
inline constexpr setup setups[] = {
    {320, 240, 500, false}, {333, 257, 800, true}, {640, 480, 5000, false}};

TYPED_TEST(order_and_grid_unit, of_rectified_pairs_is_one_after_the_other) {
  for (setup const& how : setups) {
    SCOPED_TRACE(how.features);
    this->template compare<true>(how);
  }
}

TYPED_TEST(order_and_grid_unit, of_other_images_is_one_after_the_other) {
  for (setup const& how : setups) {
    SCOPED_TRACE(how.features);
    this->template compare<false>(how);
  }
}

}  // namespace order_and_grid
