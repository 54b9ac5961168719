// SPDX-License-Identifier: Apache-2.0
// Undistorted positions of keypoints, and the grid of a frame. With FT_TEST_OPENCV positions are
// compared with OpenCV's, otherwise with the equation of the distortion read forwards.
#include <gtest/gtest.h>

#include <algorithm>
#include <cmath>
#include <cstddef>
#include <cstring>
#include <limits>
#include <memory>
#include <random>
#include <sstream>
#include <string>
#include <utility>
#include <vector>
#if FT_TEST_OPENCV
#include <opencv2/calib3d.hpp>
#include <opencv2/core.hpp>
#endif

#include "integration/orbslam3/accelerator.hpp"
#include "integration/orbslam3/front_end.hpp"
#include "integration/orbslam3/rigs.hpp"
#include "integration/orbslam3/verify.hpp"
#include "tests/integration/orbslam3/backends.hpp"
#include "tests/integration/orbslam3/constructors.hpp"
#include "tests/integration/orbslam3/heard.hpp"
#include "tests/integration/orbslam3/scene.hpp"
#include "tests/integration/orbslam3/stand_in.hpp"
#include "tests/integration/orbslam3/watched_device.hpp"
#include "tests/support/backends.hpp"
#include "tests/support/random.hpp"

namespace orbslam3_test {

namespace positions {

using accelerator = ft::orbslam3::accelerator<stand_in::types>;
/// As a user's header has it.
using types =
    ft::orbslam3::types_of<stand_in::frame, stand_in::map_point, stand_in::fisheye_camera>;
using front_end = ft::orbslam3::front_end<types>;
using ft::orbslam3::difference;
using ft::orbslam3::lens_distortion;
using ft::orbslam3::stage;
using ft::orbslam3::stage_mode;

/// fx, fy, cx, cy and k1, k2, p1, p2, k3: as EuRoC's and TUM's cameras have them, one with little
/// and one with strong distortion, whose corners are beyond where it can be inverted.
constexpr lens_distortion lenses[] = {
    {458.654f, 457.296f, 317.215f, 243.375f, -0.28340811f, 0.07395907f, 0.00019359f,
     1.76187114e-05f, 0},
    {517.306408f, 516.469215f, 318.643040f, 255.313989f, 0.262383f, -0.953104f, -0.005358f,
     0.002628f, 1.163314f},
    {400, 401, 320, 240, 1e-3f, 0, 0, 0, 0},
    {300, 300, 320, 240, -0.7f, 0.1f, 0.01f, -0.02f, 0.05f},
};

stand_in::matrix numbers(int rows, int cols, std::vector<float> const& values) {
  stand_in::matrix m;
  m.create(rows, cols, 5);
  std::memcpy(m.data, values.data(), values.size() * sizeof(float));
  return m;
}
void calibrate(stand_in::frame& f, lens_distortion const& d, int coefficients) {
  f.mK = numbers(3, 3, {d.fx, 0, d.cx, 0, d.fy, d.cy, 0, 0, 1});
  std::vector<float> k{d.k1, d.k2, d.p1, d.p2, d.k3, 0.001f, 0.002f, 0.003f};
  k.resize(static_cast<std::size_t>(coefficients));
  f.mDistCoef = numbers(coefficients, 1, k);
}
/// As many as an ORB-SLAM3 settings file states.
int coefficients_of(lens_distortion const& d) { return d.k3 == 0 ? 4 : 5; }

struct place {
  float x, y;
};
std::vector<place> places_of(std::vector<stand_in::keypoint> const& keys) {
  std::vector<place> all;
  for (auto const& k : keys) { all.push_back({k.pt.x, k.pt.y}); }
  return all;
}

#if FT_TEST_OPENCV
void expect_undistorted(lens_distortion const& d, std::vector<place> const& seen,
                        std::vector<place> const& got) {
  ASSERT_EQ(seen.size(), got.size());
  cv::Mat const K = (cv::Mat_<float>(3, 3) << d.fx, 0, d.cx, 0, d.fy, d.cy, 0, 0, 1);
  cv::Mat const k = (cv::Mat_<float>(5, 1) << d.k1, d.k2, d.p1, d.p2, d.k3);
  std::vector<cv::Point2f> from;
  for (place const& p : seen) { from.emplace_back(p.x, p.y); }
  std::vector<cv::Point2f> want;
  cv::undistortPoints(from, want, K, k, cv::noArray(), K);
  for (std::size_t i = 0; i < got.size(); ++i) {
    ASSERT_EQ(got[i].x, want[i].x) << i << " at " << seen[i].x << " " << seen[i].y;
    ASSERT_EQ(got[i].y, want[i].y) << i << " at " << seen[i].x << " " << seen[i].y;
  }
}
#else
/// Distorting the answer leads back to what was seen, as far as five steps go: to a hundredth of
/// the distortion, for lenses of moderate distortion.
void expect_undistorted(lens_distortion const& lens, std::vector<place> const& seen,
                        std::vector<place> const& got) {
  ASSERT_EQ(seen.size(), got.size());
  if (std::abs(lens.k1) > 0.5f) { return; }
  for (std::size_t i = 0; i < got.size(); ++i) {
    double const u = (static_cast<double>(got[i].x) - lens.cx) / lens.fx;
    double const v = (static_cast<double>(got[i].y) - lens.cy) / lens.fy;
    double const r2 = u * u + v * v;
    if (r2 > 0.5) { continue; }
    double const radial = 1 + lens.k1 * r2 + lens.k2 * r2 * r2 + lens.k3 * r2 * r2 * r2;
    double const x = u * radial + 2 * lens.p1 * u * v + lens.p2 * (r2 + 2 * u * u);
    double const y = v * radial + 2 * lens.p2 * u * v + lens.p1 * (r2 + 2 * v * v);
    double const moved = std::hypot(got[i].x - seen[i].x, got[i].y - seen[i].y);
    ASSERT_NEAR(x * lens.fx + lens.cx, seen[i].x, 1e-3 + 0.03 * moved) << i;
    ASSERT_NEAR(y * lens.fy + lens.cy, seen[i].y, 1e-3 + 0.03 * moved) << i;
  }
}
#endif

TEST(undistortion, has_opencvs_positions) {
  std::mt19937 random(8);
  std::uniform_real_distribution<float> x(-20, 660);
  std::uniform_real_distribution<float> y(-20, 500);
  for (lens_distortion const& d : lenses) {
    ft::orbslam3::undistortion const undistorted(d);
    std::vector<place> seen{{d.cx, d.cy}, {0, 0}, {640, 480}};
    for (int i = 0; i < 100000; ++i) { seen.push_back({x(random), y(random)}); }
    std::vector<place> got;
    for (place const& p : seen) {
      auto const q = undistorted({p.x, p.y});
      got.push_back({q.x, q.y});
    }
    expect_undistorted(d, seen, got);
  }
}

stand_in::matrix gray_view(unsigned seed) {
  auto const pixels = test::random_image(640, 480, seed);
  stand_in::matrix m;
  m.create(480, 640, 0);
  std::memcpy(m.data, pixels.data(), pixels.size());
  return m;
}

class positions_of_frames : public on_executor {};

TEST_P(positions_of_frames, are_undistorted_while_the_device_extracts) {
  for (sensor const kind : {sensor::monocular, sensor::rgbd}) {
    auto const s = settings_for(kind);
    accelerator gpu(make(s), s);
    stand_in::frame plain;
    gpu.extract(gray_view(3), plain);
    for (lens_distortion const& d : lenses) {
      for (unsigned long again = 0; again < 3; ++again) {  // both buffers
        stand_in::frame f;
        f.mnId = again;
        calibrate(f, d, coefficients_of(d));
        gpu.extract(gray_view(3), f);
        ASSERT_TRUE(gpu.can_undistort(f));
        gpu.undistort(f);
        ASSERT_GT(f.mvKeys.size(), 500u);
        ASSERT_EQ(f.mvKeys.size(), plain.mvKeys.size());
        for (std::size_t i = 0; i < f.mvKeys.size(); ++i) {
          ASSERT_EQ(f.mvKeys[i].pt.x, plain.mvKeys[i].pt.x);
          ASSERT_EQ(f.mvKeys[i].pt.y, plain.mvKeys[i].pt.y);
          ASSERT_EQ(f.mvKeysUn[i].octave, plain.mvKeys[i].octave);
          ASSERT_EQ(f.mvKeysUn[i].angle, plain.mvKeys[i].angle);
        }
        expect_undistorted(d, places_of(f.mvKeys), places_of(f.mvKeysUn));
      }
    }
  }
}

TEST_P(positions_of_frames, without_distortion_are_those_of_the_image) {
  for (sensor const kind : {sensor::monocular, sensor::rgbd, sensor::stereo}) {
    auto const s = settings_for(kind);
    accelerator gpu(make(s), s);
    stand_in::frame f;
    // ORB-SLAM3 looks at k1 alone.
    calibrate(f, {458, 457, 317, 243, 0, 0.5f, 0.1f, 0.1f, 0.1f}, 5);
    if (s.images == 2) {
      gpu.extract(gray_view(3), gray_view(4), f);
    } else {
      gpu.extract(gray_view(3), f);
    }
    ASSERT_TRUE(gpu.can_undistort(f));
    gpu.undistort(f);
    ASSERT_EQ(f.mvKeysUn.size(), f.mvKeys.size());
    for (std::size_t i = 0; i < f.mvKeys.size(); ++i) {
      ASSERT_EQ(f.mvKeysUn[i].pt.x, f.mvKeys[i].pt.x);
      ASSERT_EQ(f.mvKeysUn[i].pt.y, f.mvKeys[i].pt.y);
    }
  }
}

/// What the device has undistorted it has not to be sent, and neither has a grid to be made for the
/// search, where the bounds were known.
TEST_P(positions_of_frames, are_on_the_device_for_the_searches) {
  auto const s = settings_for(sensor::monocular);
  for (bool const by_device : {true, false}) {
    ft::orbslam3::options o;
    if (!by_device) { o[stage::undistort] = stage_mode::host; }
    auto device = std::make_unique<watched_device>(make(s));
    int sent = 0;
    device->on_call = [&](std::string const& call) { sent += static_cast<int>(call == "send"); };
    accelerator gpu(std::move(device), s, o);
    stand_in::frame last;
    stand_in::frame current;
    for (stand_in::frame* const f : {&last, &current}) {
      f->mnId = f == &last ? 0 : 1;
      f->mnMinX = -40;
      f->mnMinY = -30;
      f->mnMaxX = 680;
      f->mnMaxY = 510;
      calibrate(*f, lenses[0], 4);
      gpu.extract(gray_view(3), *f);
      EXPECT_EQ(gpu.can_undistort(*f), by_device);
      if (by_device) {
        gpu.undistort(*f);
      } else {
        f->mvKeysUn = f->mvKeys;
        ft::orbslam3::undistortion const undistorted(lenses[0]);
        for (auto& k : f->mvKeysUn) {
          auto const p = undistorted({k.pt.x, k.pt.y});
          k.pt.x = p.x;
          k.pt.y = p.y;
        }
      }
      f->Nleft = -1;
      f->mvpMapPoints.assign(f->mvKeys.size(), nullptr);
      f->mvbOutlier.assign(f->mvKeys.size(), false);
    }
    EXPECT_EQ(gpu.search_by_projection(current, last, 15, true), 0);
    EXPECT_EQ(sent, by_device ? 1 : 2);  // holders alone; positions as well
  }
}

TEST_P(positions_of_frames, are_the_cpus_where_ft_has_no_equal_ones) {
  struct row {
    sensor kind;
    int coefficients;
    bool switched_off;
  };
  for (row const& r : {row{sensor::monocular, 8, false}, row{sensor::monocular, 4, true},
                       row{sensor::stereo, 4, false}, row{sensor::rgbd, 2, false}}) {
    auto const s = settings_for(r.kind);
    ft::orbslam3::options o;
    if (r.switched_off) { o[stage::undistort] = stage_mode::host; }
    front_end gpu(make(s), s, o);
    stand_in::frame f;
    calibrate(f, lenses[0], r.coefficients);
    auto const nobody = [] { ADD_FAILURE() << "the CPU is asked to extract"; };
    if (s.images == 2) {
      gpu.extract(f, nobody, gray_view(3), gray_view(4));
    } else {
      gpu.extract(f, nobody, gray_view(3));
    }
    int calls = 0;
    ft::orbslam3::undistort(&gpu, f, [&] { ++calls; });
    EXPECT_EQ(calls, 1);
    ASSERT_GT(f.mvKeys.size(), 100u);
    for (auto const& k : f.mvKeys) {  // as extracted
      if (k.octave == 0) { ASSERT_EQ(k.pt.x, std::round(k.pt.x)); }
    }
  }
  int calls = 0;
  stand_in::frame f;
  ft::orbslam3::undistort<types>(nullptr, f, [&] { ++calls; });
  ft::orbslam3::assign_to_grid<types>(nullptr, f, [&] { ++calls; });
  EXPECT_EQ(calls, 2);
}

// ---- the grid

/// A loop over all keypoints, from section 7 of docs/reference_behaviour.md.
using grid = std::vector<std::size_t>[64][48];
void push_all(stand_in::frame const& f, std::vector<stand_in::keypoint> const& keys, grid& to) {
  float const inv_width = 64 / (f.mnMaxX - f.mnMinX);
  float const inv_height = 48 / (f.mnMaxY - f.mnMinY);
  for (std::size_t i = 0; i < keys.size(); ++i) {
    auto const x = std::round((keys[i].pt.x - f.mnMinX) * inv_width);
    auto const y = std::round((keys[i].pt.y - f.mnMinY) * inv_height);
    if (!(x >= 0 && x < 64 && y >= 0 && y < 48)) { continue; }
    to[static_cast<int>(x)][static_cast<int>(y)].push_back(i);
  }
}
void push_all(stand_in::frame& f) {
  bool const two = f.Nleft != -1;
  push_all(f, two ? f.mvKeys : f.mvKeysUn, f.mGrid);
  if (two) { push_all(f, f.mvKeysRight, f.mGridRight); }
}
void expect_equal(grid const& got, grid const& want) {
  for (int x = 0; x < 64; ++x) {
    for (int y = 0; y < 48; ++y) { ASSERT_EQ(got[x][y], want[x][y]) << x << " " << y; }
  }
}

TEST_P(positions_of_frames, are_sorted_into_the_cells_of_a_plain_loop) {
  for (sensor const kind : all_sensors) {
    for (unsigned seed = 1; seed < 4; ++seed) {
      scene s(kind, seed);
      accelerator gpu(make(s.settings), s.settings);
      for (stand_in::frame* const f : {&s.last, &s.current}) {
        auto want = std::make_unique<stand_in::frame>(*f);
        push_all(*want);
        gpu.assign_to_grid(*f);
        expect_equal(f->mGrid, want->mGrid);
        expect_equal(f->mGridRight, want->mGridRight);
      }
    }
  }
}

TEST_P(positions_of_frames, at_the_edges_of_cells_and_of_the_image_are_where_the_loop_has_them) {
  auto const s = settings_for(sensor::monocular);
  accelerator gpu(make(s), s);
  auto f = std::make_unique<stand_in::frame>();
  f->Nleft = -1;
  f->mnMinX = -16;
  f->mnMinY = -24;
  f->mnMaxX = 624;  // cells of 10 by 10 pixels
  f->mnMaxY = 456;
  float const beyond = std::numeric_limits<float>::infinity();
  std::vector<float> edges{-beyond, -1e30f, -36, beyond, 1e30f, std::nanf("")};
  for (int i = -4; i < 140; ++i) {
    float const at = -16 + 5 * static_cast<float>(i);  // corners and centres of cells
    edges.insert(edges.end(), {std::nextafter(at, -beyond), at, std::nextafter(at, beyond)});
  }
  for (float const x : edges) {
    for (float const y : {edges[7], 0.0f, 100.0f, std::nanf("")}) {
      stand_in::keypoint k;
      k.pt = {x, y};
      f->mvKeysUn.push_back(k);
      k.pt = {y, x - 8};
      f->mvKeysUn.push_back(k);
    }
  }
  f->mvKeys = f->mvKeysUn;
  auto want = std::make_unique<stand_in::frame>(*f);
  push_all(*want);
  std::size_t inside = 0;
  for (auto const& column : want->mGrid) {
    for (auto const& cell : column) { inside += cell.size(); }
  }
  ASSERT_GT(inside, 1000u);
  gpu.assign_to_grid(*f);
  expect_equal(f->mGrid, want->mGrid);
  f->mvKeys.clear();
  f->mvKeysUn.clear();
  gpu.assign_to_grid(*f);  // replaces
  for (auto const& column : f->mGrid) {
    for (auto const& cell : column) { ASSERT_TRUE(cell.empty()); }
  }
}

// ---- verify

TEST_P(positions_of_frames, are_verified_and_each_difference_is_named) {
  auto const s = settings_for(sensor::monocular);
  accelerator gpu(make(s), s);
  std::vector<difference> found;
  ft::orbslam3::verifier<stand_in::types> both(gpu, [&](auto const& d) { found.push_back(d); });
  stand_in::frame f;
  calibrate(f, lenses[0], 4);
  gpu.extract(gray_view(3), f);
  f.Nleft = -1;
  f.mnMaxX = 640;
  f.mnMaxY = 480;
  gpu.undistort(f);
  auto const undistorted = f.mvKeysUn;
  both.undistort(f, [&] { f.mvKeysUn = undistorted; });
  EXPECT_EQ(found.size(), 0u);
  both.undistort(f, [&] {
    f.mvKeysUn = undistorted;
    f.mvKeysUn[5].pt.y = std::nextafter(f.mvKeysUn[5].pt.y, 0.0f);
  });
  ASSERT_EQ(found.size(), 1u);
  EXPECT_EQ(found[0].where, stage::undistort);
  EXPECT_EQ(found[0].index, 5);
  EXPECT_EQ(f.mvKeysUn[5].pt.y, undistorted[5].pt.y) << "the accelerator's answer stays";
  found.clear();
  both.assign_to_grid(f, [&] { push_all(f); });
  EXPECT_EQ(found.size(), 0u);
  both.assign_to_grid(f, [&] {
    for (int x = 0; x < 64; ++x) {
      for (auto& cell : f.mGrid[x]) { cell.clear(); }
    }
    push_all(f);
    f.mGrid[3][7].push_back(9999);
    for (auto& column : f.mGrid) {
      for (auto& cell : column) {
        if (&cell == &f.mGrid[3][7] || cell.size() < 2) { continue; }
        std::swap(cell[0], cell[1]);
        return;
      }
    }
  });
  ASSERT_EQ(found.size(), 2u);
  EXPECT_EQ(found[0].where, stage::grid);
  EXPECT_TRUE(found[0].index == 3 * 48 + 7 || found[1].index == 3 * 48 + 7);
  auto want = std::make_unique<stand_in::frame>(f);
  for (auto& column : want->mGrid) {
    for (auto& cell : column) { cell.clear(); }
  }
  push_all(*want);
  expect_equal(f.mGrid, want->mGrid);
}

TEST_P(positions_of_frames, in_the_order_of_a_constructor_are_verified_by_the_front_end) {
  for (sensor const kind : {sensor::monocular, sensor::stereo, sensor::fisheye_stereo}) {
    SCOPED_TRACE(name_of(kind));
    auto const s = settings_for(kind);
    heard quiet;
    ft::orbslam3::options o;
    o.verify = true;
    o[stage::extract] = stage_mode::device;
    front_end gpu(make(s), s, o);
    accelerator cpu(make(s), s);
    int by_cpu = 0;
    stand_in::steps by;
    if (kind == sensor::monocular) {
      by.calibrate = [](stand_in::frame& f) { calibrate(f, lenses[0], 4); };
    }
    by.features = [&](stand_in::frame& f) {
      if (s.images == 2) {
        gpu.extract(
            f, [&] { cpu.extract(gray_view(3), gray_view(4), f); }, gray_view(3), gray_view(4));
      } else {
        gpu.extract(
            f, [&] { cpu.extract(gray_view(3), f); }, gray_view(3));
      }
    };
    by.undistort = [&](stand_in::frame& f) {
      gpu.undistort(f, [&] {
        ++by_cpu;
        cpu.undistort(f);
      });
    };
    by.grid = [&](stand_in::frame& f) {
      gpu.assign_to_grid(f, [&] {
        ++by_cpu;
        push_all(f);
      });
    };
    if (kind == sensor::fisheye_stereo) {
      by.stereo = [&](stand_in::frame& f) {
        gpu.stereo_fisheye(f, [&] { cpu.compute_stereo_fisheye_matches(f); });
      };
    }
    auto const f = std::make_unique<stand_in::frame>(stand_in::construct(kind, 0, by));
    EXPECT_EQ(by_cpu, 2);
    std::ostringstream text;
    gpu.print(text);
    EXPECT_NE(text.str().find("1 frames, 0 with differences"), std::string::npos) << text.str();
    EXPECT_NE(text.str().find("verify: grid: 1 calls"), std::string::npos) << text.str();
    EXPECT_NE(text.str().find("verify: undistort: 1 calls"), std::string::npos) << text.str();
  }
}

INSTANTIATE_TEST_SUITE_P(executors, positions_of_frames, ::testing::ValuesIn(executors()),
                         executor_name);

}  // namespace positions

}  // namespace orbslam3_test
