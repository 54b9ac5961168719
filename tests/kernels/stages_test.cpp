// SPDX-License-Identifier: Apache-2.0
// Every stage and pipeline on two executors, from the same fresh inputs, bit for bit: the host
// against the device where there is one, one thread against all threads in a build without CUDA.
#include <gtest/gtest.h>

#include <algorithm>
#include <cmath>
#include <cstdint>
#include <cstring>
#include <limits>
#include <random>
#include <string>
#include <type_traits>
#include <utility>
#include <vector>

#include "ft/cameras/kannala_brandt.hpp"
#include "ft/cameras/pinhole.hpp"
#include "ft/cameras/stereo_rig.hpp"
#include "ft/containers/feature_grid.hpp"
#include "ft/containers/frame.hpp"
#include "ft/containers/image_pyramid.hpp"
#include "ft/containers/keypoints.hpp"
#include "ft/containers/map_points.hpp"
#include "ft/containers/stereo_matches.hpp"
#include "ft/kernels/grid.hpp"
#include "ft/kernels/pose/optimize_frame.hpp"
#include "ft/kernels/search/assignment.hpp"
#include "ft/kernels/search/frustum.hpp"
#include "ft/kernels/search/last_frame.hpp"
#include "ft/kernels/search/workspace.hpp"
#include "ft/kernels/stereo/fisheye.hpp"
#include "ft/kernels/stereo/rectified.hpp"
#include "ft/pipelines/frame_tracker.hpp"
#include "ft/pipelines/orb_extractor.hpp"
#include "ft/pipelines/stereo_matcher.hpp"
#include "tests/support/backends.hpp"
#include "tests/support/corners.hpp"
#include "tests/support/random.hpp"
#include "tests/support/tracking.hpp"

namespace stages_parity {

using test::at;
using test::generator;

// ---- the two executors ------------------------------------------------------------------------

#if defined(__CUDACC__)
struct executors {
  ft::host_exec first{};
  test::cuda_backend device;
  ft::cuda_exec const& second = device.exec;
  static bool available() { return test::cuda_backend::available(); }
};
#else
struct executors {
  ft::host_exec first{1};
  ft::host_exec second{0};
  static bool available() { return true; }
};
#endif

class stage_parity : public ::testing::Test {
protected:
  void SetUp() override {
    if (!executors::available()) { GTEST_SKIP() << "no CUDA device"; }
  }
};

// ---- comparison -------------------------------------------------------------------------------

/// Named arrays as bytes, in the order in which a stage gave them.
class record {
public:
  template <typename T>
  void add(std::string const& name, std::vector<T> const& values) {
    static_assert(std::is_trivially_copyable<T>::value, "compared as bytes");
    entry e{name, sizeof(T), std::vector<unsigned char>(values.size() * sizeof(T))};
    if (!values.empty()) { std::memcpy(e.bytes.data(), values.data(), e.bytes.size()); }
    entries_.push_back(std::move(e));
  }
  friend void expect_same_bits(record const& a, record const& b) {
    ASSERT_EQ(a.entries_.size(), b.entries_.size());
    for (std::size_t i = 0; i < a.entries_.size(); ++i) {
      entry const& x = a.entries_[i];
      entry const& y = b.entries_[i];
      ASSERT_EQ(x.name, y.name);
      ASSERT_EQ(x.bytes.size(), y.bytes.size()) << x.name << ": another number of elements";
      if (x.bytes == y.bytes) { continue; }
      auto const where = std::mismatch(x.bytes.begin(), x.bytes.end(), y.bytes.begin());
      auto const element = at(where.first - x.bytes.begin()) / x.size;
      int different = 0;
      for (std::size_t k = 0; k < x.bytes.size(); k += x.size) {
        different += static_cast<int>(std::memcmp(&x.bytes[k], &y.bytes[k], x.size) != 0);
      }
      ADD_FAILURE() << x.name << ": " << different << " of " << x.bytes.size() / x.size
                    << " elements differ, first " << element << ": " << x.show(element) << " and "
                    << y.show(element);
    }
  }

private:
  struct entry {
    std::string name;
    std::size_t size;
    std::vector<unsigned char> bytes;

    /// An element as words of 32 bits, as integers and as floats.
    std::string show(std::size_t element) const {
      std::string text = "{";
      for (std::size_t k = 0; k < size; k += 4) {
        std::uint32_t word = 0;
        float number = 0;
        std::memcpy(&word, &bytes[element * size + k], std::min<std::size_t>(4, size - k));
        std::memcpy(&number, &word, 4);
        text += (k == 0 ? "" : ", ") + std::to_string(static_cast<std::int32_t>(word)) + " (" +
                std::to_string(number) + ")";
      }
      return text + "}";
    }
  };
  std::vector<entry> entries_;
};

template <typename T>
std::vector<T> head(std::vector<T> const& v, std::ptrdiff_t first, std::ptrdiff_t count) {
  return std::vector<T>(v.begin() + first, v.begin() + first + count);
}

// ---- random inputs ----------------------------------------------------------------------------

using image = std::vector<std::uint8_t>;

enum class picture { structured, low_contrast, noise, black, kinds };

image make_image(picture kind, int width, int height, unsigned seed) {
  image pixels = test::random_image(width, height, seed);
  std::mt19937 random(seed);
  for (auto& p : pixels) {
    if (kind == picture::low_contrast) { p = static_cast<std::uint8_t>(110 + p / 12); }
    if (kind == picture::noise) { p = static_cast<std::uint8_t>(random()); }
    if (kind == picture::black) { p = 0; }
  }
  return pixels;
}

/// What a second camera could see of an image: rows moved to the left by their own disparities.
image shifted(image const& from, int width, int height, int most, int down, unsigned seed) {
  std::mt19937 random(seed);
  image to(from.size());
  int disparity = 0;
  for (int y = 0; y < height; ++y) {
    if (y % 60 == 0) { disparity = static_cast<int>(random() % static_cast<unsigned>(most + 1)); }
    int const row = std::min(y + down, height - 1);
    for (int x = 0; x < width; ++x) {
      int const value = from[at(row) * at(width) + at(std::min(x + disparity, width - 1))];
      int const noise = static_cast<int>(random() % 3) - 1;
      to[at(y) * at(width) + at(x)] =
          static_cast<std::uint8_t>(std::min(255, std::max(0, value + noise)));
    }
  }
  return to;
}

// ---- features and stereo ----------------------------------------------------------------------

struct feature_case {
  ft::orb_params params;
  std::vector<image> images;
  std::vector<ft::stereo_overlap> overlaps;
};

template <typename Exec>
void add_pyramid(record& r, Exec const& exec, char const* name,
                 ft::image_pyramid_view const& pyramid) {
  auto const& g = pyramid.geometry;
  auto const slab = test::from_exec(exec, static_cast<std::uint8_t const*>(pyramid.data),
                                    at(g.bytes * pyramid.batch));
  for (int l = 0; l < g.levels; ++l) {
    std::vector<std::uint8_t> pixels;  // without what pads the rows
    for (int i = 0; i < pyramid.batch; ++i) {
      for (int y = 0; y < g.height[l]; ++y) {
        auto const row =
            slab.begin() + i * g.bytes + g.offset[l] + static_cast<std::ptrdiff_t>(y) * g.stride[l];
        pixels.insert(pixels.end(), row, row + g.width[l]);
      }
    }
    r.add(std::string(name) + " level " + std::to_string(l), pixels);
  }
}

template <typename Exec>
void add_keypoints(record& r, Exec const& exec, ft::keypoints_view const& kp) {
  auto const count = test::from_exec(exec, static_cast<int const*>(kp.count), at(kp.batch));
  r.add("keypoint counts", count);
  auto const add = [&](char const* name, auto const& values) {
    for (int i = 0; i < kp.batch; ++i) {
      r.add(std::string(name) + " of image " + std::to_string(i),
            head(values, static_cast<std::ptrdiff_t>(i) * kp.capacity, count[at(i)]));
    }
  };
  add("x", test::column<ft::field::x>(exec, kp));
  add("y", test::column<ft::field::y>(exec, kp));
  add("angle", test::column<ft::field::angle>(exec, kp));
  add("response", test::column<ft::field::response>(exec, kp));
  add("octave", test::column<ft::field::octave>(exec, kp));
  add("descriptor", test::column<ft::field::orb>(exec, kp));
}

template <typename Exec>
void add_grid(record& r, Exec const& exec, char const* name, ft::feature_grid_view const& grid,
              int batch) {
  auto const cells = static_cast<std::ptrdiff_t>(grid.geometry.cells());
  auto const start =
      test::from_exec(exec, static_cast<int const*>(grid.start), at(batch * (cells + 1)));
  auto const indices = test::from_exec(exec, static_cast<int const*>(grid.indices),
                                       at(static_cast<std::ptrdiff_t>(batch) * grid.capacity));
  r.add(std::string(name) + " start", start);
  for (int b = 0; b < batch; ++b) {
    r.add(std::string(name) + " indices",
          head(indices, static_cast<std::ptrdiff_t>(b) * grid.capacity,
               start[at(b * (cells + 1) + cells)]));
  }
}

/// @return how many left keypoints have a depth
template <typename Exec>
int add_stereo(record& r, Exec const& exec, ft::stereo_matches_view const& m) {
  auto const count = test::from_exec(exec, static_cast<int const*>(m.count), at(m.batch));
  auto const right_x = test::column<ft::field::right_x>(exec, m);
  auto const depth = test::column<ft::field::depth>(exec, m);
  auto const score = test::column<ft::field::score>(exec, m);
  r.add("stereo counts", count);
  r.add("right_x", right_x);
  r.add("depth", depth);
  r.add("score", score);
  return static_cast<int>(std::count_if(depth.begin(), depth.end(), [](float d) { return d > 0; }));
}

struct feature_totals {
  long corners = 0, keypoints = 0, stereo = 0;
};

template <typename Exec>
record extract(Exec const& exec, feature_case const& c, feature_totals& totals) {
  record r;
  auto const& p = c.params;
  int const batch = static_cast<int>(c.images.size());
  ft::orb_extractor<Exec> orb(exec, p, batch, c.overlaps);
  for (int i = 0; i < batch; ++i) {
    orb.upload(exec, i, {c.images[at(i)].data(), p.width, p.height, p.width});
  }
  orb.extract(exec);
  add_pyramid(r, exec, "pyramid", orb.pyramid());
  add_pyramid(r, exec, "blur", orb.blurred());
  auto const corners = orb.corners();
  auto const kept = orb.distribution();
  int const levels = p.levels;
  auto list = test::from_exec(exec, static_cast<ft::corner const*>(corners.list),
                              at(batch * corners.layout.total_slots));
  auto const list_count =
      test::from_exec(exec, static_cast<int const*>(corners.list_count), at(batch * levels));
  auto const kept_list =
      test::from_exec(exec, static_cast<ft::corner const*>(kept.kept),
                      at(static_cast<std::ptrdiff_t>(batch) * kept.layout.total));
  auto const kept_count =
      test::from_exec(exec, static_cast<int const*>(kept.kept_count), at(batch * levels));
  r.add("corner counts", list_count);
  r.add("kept counts", kept_count);
  for (int i = 0; i < batch; ++i) {
    for (int l = 0; l < levels; ++l) {
      std::string const where = " of image " + std::to_string(i) + " level " + std::to_string(l);
      int const n = list_count[at(i * levels + l)];
      auto const first = i * corners.layout.total_slots + corners.layout.first_slot[l];
      test::sort_corners(list.data() + first, n, corners.layout, l);
      r.add("corners" + where, head(list, first, n));
      r.add(
          "kept corners" + where,
          head(kept_list, static_cast<std::ptrdiff_t>(i) * kept.layout.total + kept.layout.first[l],
               kept_count[at(i * levels + l)]));
      totals.corners += n;
      totals.keypoints += kept_count[at(i * levels + l)];
    }
  }
  add_keypoints(r, exec, orb.keypoints());
  r.add("mono counts", test::from_exec(exec, orb.mono_count(), at(batch)));
  ft::feature_grid<Exec::space> grid(
      ft::grid_geometry::over(0, 0, static_cast<float>(p.width), static_cast<float>(p.height)),
      orb.capacity(), batch);
  ft::build_grid<ft::nearest_cell>(exec, orb.keypoints(), 0, 1, batch, grid.view());
  add_grid(r, exec, "grid", grid.view(), batch);
  if (batch % 2 == 0) {
    auto const rig =
        ft::rectified_rig::make({static_cast<float>(p.width) * 0.6f, 400, 300, 200}, 0.11f);
    ft::stereo_matcher<Exec> stereo(rig, orb);
    stereo.match(exec, orb);
    totals.stereo += add_stereo(r, exec, stereo.matches());
  }
  return r;
}

TEST_F(stage_parity, features_and_stereo_of_images) {
  struct size {
    int width, height;
  };
  constexpr size sizes[] = {{333, 257}, {752, 480}, {1226, 370}, {97, 131},
                            {640, 400}, {67, 67},   {241, 700}};
  executors on;
  feature_totals first, second;
  unsigned seed = 0;
  for (auto const& s : sizes) {
    for (int variant = 0; variant < 6; ++variant) {
      ++seed;
      generator g(seed);
      feature_case c;
      c.params.width = s.width;
      c.params.height = s.height;
      c.params.features = variant == 0 ? 1200 : g.from_to(1, 2000);
      if (variant > 2) {
        c.params.levels = g.from_to(1, 9);
        c.params.scale_factor = g.real(1.1f, 1.4f);
        c.params.ini_threshold = g.from_to(5, 40);
        c.params.min_threshold = std::min(g.from_to(0, 12), c.params.ini_threshold);
      }
      int const batch = 1 + variant % 4;
      for (int i = 0; i < batch; ++i) {
        auto const kind = variant == 0 || variant == 3
                              ? picture::structured
                              : static_cast<picture>(g.below(static_cast<int>(picture::kinds)));
        c.images.push_back(
            i % 2 == 1 && g.chance(80)
                ? shifted(c.images.back(), s.width, s.height, s.width / 12, 0, seed + 77)
                : make_image(kind, s.width, s.height, 31 * seed + static_cast<unsigned>(i)));
        float const x = g.real(0, static_cast<float>(s.width));
        if (variant % 2 == 1) {
          c.overlaps.push_back({x, x + g.real(0, static_cast<float>(s.width))});
        }
      }
      SCOPED_TRACE("seed " + std::to_string(seed) + ": " + std::to_string(s.width) + "x" +
                   std::to_string(s.height) + ", batch " + std::to_string(batch) + ", " +
                   std::to_string(c.params.levels) + " levels");
      expect_same_bits(extract(on.first, c, first), extract(on.second, c, second));
      if (HasFailure()) { return; }
    }
  }
  EXPECT_GT(first.corners, 50000);
  EXPECT_GT(first.keypoints, 10000);
  EXPECT_GT(first.stereo, 1000);
}

/// Keypoints of anywhere, as no extractor makes them.
struct loose_keypoints {
  int capacity, images;
  std::vector<float> x, y, angle;
  std::vector<int> octave, count;
  std::vector<ft::descriptor> orb;

  loose_keypoints(generator& g, int most, int n, float width, float height, int levels,
                  bool not_finite)
      : capacity(most), images(n) {
    std::vector<ft::descriptor> looks;
    for (int i = 0; i < 40; ++i) { looks.push_back(g.descriptor()); }
    bool const whole = g.chance(40);
    for (int b = 0; b < n; ++b) {
      count.push_back(g.chance(10) ? 0 : g.from_to(most / 2, most));
      for (int i = 0; i < most; ++i) {
        float u = g.real(-0.1f, 1.1f) * width;
        float v = g.real(-0.1f, 1.1f) * height;
        if (whole) {
          u = std::floor(u);
          v = std::floor(v);
        }
        if (not_finite && g.chance(2)) { u = std::numeric_limits<float>::quiet_NaN(); }
        if (not_finite && g.chance(2)) {
          v = g.chance(50) ? -std::numeric_limits<float>::infinity() : 1e30f;
        }
        x.push_back(u);
        y.push_back(v);
        angle.push_back(g.real(0, 360));
        octave.push_back(g.below(levels));
        orb.push_back(g.flipped(looks[at(g.below(40))], g.below(30)));
      }
    }
  }
  template <typename Exec>
  void upload(Exec const& exec, ft::keypoints_view const& to) const {
    auto const put = [&](auto* target, auto const& values) {
      ft::copy(exec, target, values.data(), values.size());
    };
    put(ft::array_of<ft::field::x>(to), x);
    put(ft::array_of<ft::field::y>(to), y);
    put(ft::array_of<ft::field::angle>(to), angle);
    put(ft::array_of<ft::field::octave>(to), octave);
    put(ft::array_of<ft::field::orb>(to), orb);
    put(to.count, count);
    exec.wait();
  }
};

TEST_F(stage_parity, grids_of_any_keypoints) {
  executors on;
  for (unsigned seed = 0; seed < 60; ++seed) {
    SCOPED_TRACE("seed " + std::to_string(seed));
    generator g(seed);
    float const width = g.real(20, 1300);
    float const height = g.real(20, 800);
    int const step = g.from_to(1, 2);
    int const images = g.from_to(1, 4);
    loose_keypoints const kp(g, g.from_to(1, 1500), step * images, width, height, 8, true);
    float const min_x = g.chance(50) ? 0.0f : g.real(-20, 20);
    auto const nearest = g.chance(50) ? ft::grid_geometry::over(min_x, 0, width, height)
                                      : ft::grid_geometry::over(min_x, 0, width, height,
                                                                g.from_to(1, 70), g.from_to(1, 70));
    ft::grid_geometry rows;
    rows.cols = 1;
    rows.rows = std::max(1, static_cast<int>(height));
    auto const run = [&](auto const& exec) {
      constexpr auto space = std::decay_t<decltype(exec)>::space;
      record r;
      ft::keypoints<space> keypoints(kp.capacity, kp.images);
      kp.upload(exec, keypoints.view());
      ft::feature_grid<space> grid(nearest, kp.capacity, images);
      ft::feature_grid<space> row_grid(rows, kp.capacity, images);
      ft::build_grid<ft::nearest_cell>(exec, keypoints.view(), step - 1, step, images, grid.view());
      ft::build_grid<ft::row_cell>(exec, keypoints.view(), 0, step, images, row_grid.view());
      add_grid(r, exec, "nearest cells", grid.view(), images);
      add_grid(r, exec, "rows", row_grid.view(), images);
      return r;
    };
    expect_same_bits(run(on.first), run(on.second));
    if (HasFailure()) { return; }
  }
}

TEST_F(stage_parity, rectified_stereo_of_any_keypoints) {
  executors on;
  int found = 0;
  for (unsigned seed = 0; seed < 40; ++seed) {
    SCOPED_TRACE("seed " + std::to_string(seed));
    generator g(500 + seed);
    int const width = g.from_to(120, 500);
    int const height = g.from_to(100, 300);
    int const pairs = g.from_to(1, 3);
    auto const geometry = ft::pyramid_geometry::make(width, height, g.from_to(1, 6), 1.2f);
    std::vector<ft::resize_tap> taps(at(geometry.taps));
    ft::make_resize_taps(geometry, taps.data());
    std::vector<image> images;
    for (int i = 0; i < pairs; ++i) {
      images.push_back(test::random_image(width, height, seed * 7 + static_cast<unsigned>(i)));
      images.push_back(shifted(images.back(), width, height, 30, 0, seed));
    }
    loose_keypoints kp(g, g.from_to(50, 900), 2 * pairs, static_cast<float>(width),
                       static_cast<float>(height), geometry.levels, false);
    for (int p = 0; p < pairs; ++p) {  // many right keypoints are left ones, moved
      for (int i = 0; i < kp.capacity; i += 2) {
        auto const l = at((2 * p) * kp.capacity + i);
        auto const r = at((2 * p + 1) * kp.capacity + i);
        kp.x[r] = kp.x[l] - g.real(0, 30);
        kp.y[r] = kp.y[l] + g.real(-2, 2);
        kp.octave[r] = kp.octave[l];
        kp.orb[r] = g.flipped(kp.orb[l], g.below(30));
      }
    }
    ft::stereo_params params;
    params.bf = g.real(20, 60);
    params.max_disparity = g.real(10, 200);
    ft::grid_geometry rows;
    rows.cols = 1;
    rows.rows = height;
    auto const run = [&](auto const& exec) {
      constexpr auto space = std::decay_t<decltype(exec)>::space;
      ft::keypoints<space> keypoints(kp.capacity, kp.images);
      kp.upload(exec, keypoints.view());
      ft::image_pyramid<space> pyramid(geometry, 2 * pairs);
      for (int i = 0; i < 2 * pairs; ++i) {
        ft::copy_image(exec, pyramid.view().level(i, 0),
                       {images[at(i)].data(), width, height, width});
      }
      auto const d_taps = test::to_exec(exec, taps);
      ft::build_pyramid(exec, pyramid.view(), d_taps.data());
      ft::stereo_matches<space> matches(kp.capacity, pairs);
      ft::feature_grid<space> right_rows(rows, kp.capacity, pairs);
      ft::match_stereo_rectified(exec, pyramid.view(), keypoints.view(), params, matches.view(),
                                 right_rows.view());
      record r;
      found += add_stereo(r, exec, matches.view());
      return r;
    };
    expect_same_bits(run(on.first), run(on.second));
    if (HasFailure()) { return; }
  }
  EXPECT_GT(found, 300);
}

// ---- rigs -------------------------------------------------------------------------------------

using fisheye_rig = ft::stereo_rig<ft::kannala_brandt<float>, ft::kannala_brandt<float>>;
using pinhole_rig = ft::stereo_rig<ft::pinhole<float>, ft::pinhole<float>>;
using mixed_rig = ft::stereo_rig<ft::pinhole<float>, ft::kannala_brandt<float>>;

constexpr float image_width = 752;
constexpr float image_height = 480;

ft::pose small_motion(generator& g, float angle, float length) {
  float const a = g.real(-angle, angle);
  float const b = g.real(-angle, angle);
  float const c = g.real(-angle, angle);
  ft::mat3<float> const x{{1, 0, 0, 0, std::cos(a), -std::sin(a), 0, std::sin(a), std::cos(a)}};
  ft::mat3<float> const y{{std::cos(b), 0, std::sin(b), 0, 1, 0, -std::sin(b), 0, std::cos(b)}};
  ft::mat3<float> const z{{std::cos(c), -std::sin(c), 0, std::sin(c), std::cos(c), 0, 0, 0, 1}};
  return {x * y * z, {g.real(-length, length), g.real(-length, length), g.real(-length, length)}};
}

template <typename Camera>
Camera make_camera(generator& g) {
  float const fx = g.real(280, 420);
  float const fy = g.real(280, 420);
  if constexpr (ft::num_params_v<Camera> == 4) {
    return {fx, fy, g.real(360, 390), g.real(220, 260)};
  } else {
    return {fx,
            fy,
            g.real(360, 390),
            g.real(220, 260),
            g.real(-0.02f, 0.02f),
            g.real(-0.01f, 0.01f),
            g.real(-0.005f, 0.005f),
            g.real(-0.001f, 0.001f)};
  }
}

template <typename Rig>
Rig make_rig(generator& g) {
  if constexpr (Rig::rectified) {
    return ft::rectified_rig::make(make_camera<ft::pinhole<float>>(g), g.real(0.05f, 0.3f));
  } else {
    ft::pose T_rl = small_motion(g, 0.05f, 0.02f);
    T_rl.t.x -= g.real(0.05f, 0.3f);
    return {make_camera<typename Rig::left_type>(g), make_camera<typename Rig::right_type>(g),
            T_rl};
  }
}

/// Pixel of a point given in the left camera's frame. @param c 0 left, 1 right
template <typename Rig>
ft::projection<float> see(Rig const& rig, int c, ft::vec3<float> p) {
  if constexpr (Rig::rectified) {
    return rig.camera.project(p);
  } else {
    return c == 0 ? rig.left.project(p) : rig.right.project(rig.T_rl * p);
  }
}

template <typename Rig>
constexpr int cameras_of = Rig::rectified ? 1 : 2;

// ---- search, frustum and pose -----------------------------------------------------------------

/// A last frame, a current one and a map, of a batch of camera pairs.
template <typename Rig>
struct tracking_case {
  static constexpr int cameras = cameras_of<Rig>;
  Rig rig;
  int batch, points, capacity;
  ft::pyramid_geometry geometry;
  std::vector<ft::pose> last, predicted, truth;   ///< T_cw
  std::vector<ft::vec3<float>> position, normal;  ///< [batch][points]
  std::vector<float> min_distance, max_distance;
  std::vector<ft::descriptor> orb;
  std::vector<int> observations;
  loose_keypoints last_keypoints, keypoints;  ///< two images per batch entry
  std::vector<int> last_holder;               ///< [batch][cameras][capacity]
  std::vector<float> right_x;                 ///< [batch][capacity]
  std::vector<int> partner;                   ///< [batch][cameras][capacity]
  std::vector<int> slots, slot_count;         ///< local map [batch][points]
  std::vector<int> stamps, stamp;             ///< [batch][points], [batch]
  ft::last_search_params last_params;
  ft::local_search_params local_params;
  ft::frustum_params frustum;

  tracking_case(generator& g, int most_points)
      : rig(make_rig<Rig>(g)),
        batch(g.from_to(1, 4)),
        points(g.from_to(most_points / 3, most_points)),
        capacity(points + g.below(30)),
        geometry(ft::pyramid_geometry::make(752, 480, 8, 1.2f)),
        last_keypoints(g, capacity, 2 * batch, image_width, image_height, 8, false),
        keypoints(g, capacity, 2 * batch, image_width, image_height, 8, false) {
    frustum.max_x = last_params.max_x = image_width;
    frustum.max_y = last_params.max_y = image_height;
    frustum.levels = 8;
    frustum.log_scale_factor = ft::log_rounded(1.2f);
    last_params.window_radius = g.real(3, 20);
    last_params.ignore_motion_direction = g.chance(20);
    last_params.reference_quirks = g.chance(20);
    local_params.radius_factor = g.real(0.5f, 4);
    if (g.chance(30)) { local_params.max_distance = g.real(3, 12); }
    right_x.assign(at(batch * capacity), -1.0f);
    partner.assign(at(batch * cameras * capacity), -1);
    last_holder.assign(at(batch * cameras * capacity), -1);
    slots.assign(at(batch * points), -1);
    for (int b = 0; b < batch; ++b) {
      last.push_back(small_motion(g, 0.6f, 2));
      truth.push_back(small_motion(g, 0.02f, g.chance(50) ? 0.05f : 0.5f) * last.back());
      predicted.push_back(small_motion(g, 0.01f, 0.03f) * truth.back());
      stamp.push_back(5);
      slot_count.push_back(g.chance(10) ? 0 : g.from_to(points / 2, points));
      for (int i = 0; i < points; ++i) {
        add_point(g, b, i);
        slots[at(b * points + i)] =
            g.chance(4) ? points + g.below(50) : (g.chance(4) ? -1 : g.below(points));
        stamps.push_back(g.chance(15) ? 5 : g.below(5));
      }
    }
  }

private:
  void add_point(generator& g, int b, int i) {
    ft::vec3<float> const in_last{g.real(-4, 4), g.real(-2.5f, 2.5f),
                                  g.chance(5) ? g.real(-2, 0.1f) : g.real(1, 9)};
    ft::pose const T_wl = last[at(b)].inverse();
    ft::vec3<float> const world = T_wl * in_last;
    float const distance = std::sqrt(ft::dot(in_last, in_last));
    int const level = g.below(8);
    ft::descriptor const look = g.descriptor();
    float const wild = g.chance(2) ? std::numeric_limits<float>::quiet_NaN() : 0.0f;
    position.push_back({world.x + wild, world.y, world.z});
    ft::vec3<float> const view = world - T_wl.t;
    float const length = g.chance(10) ? -distance : distance;
    normal.push_back({view.x / length + g.real(-0.4f, 0.4f), view.y / length, view.z / length});
    max_distance.push_back(g.chance(3) ? 0.0f : distance * geometry.scale[level]);
    min_distance.push_back(max_distance.back() / geometry.scale[7]);
    orb.push_back(look);
    observations.push_back(g.chance(10) ? 0 : g.from_to(1, 5));
    int numbers[2] = {-1, -1};
    for (int c = 0; c < cameras; ++c) {
      // Keypoints of both frames are in a random order: i at place (7 i) modulo the capacity or so.
      int const k_last = i;
      int const k = (i + 13 * b) % points;
      auto const before = at((2 * b + c) * capacity + k_last);
      auto const now = at((2 * b + c) * capacity + k);
      auto const seen_last = see(rig, c, in_last);
      auto const seen_now = see(rig, c, truth[at(b)] * world);
      float const angle = g.real(0, 360);
      if (seen_last.valid && g.chance(90)) {
        last_keypoints.x[before] = seen_last.pixel.x;
        last_keypoints.y[before] = seen_last.pixel.y;
        last_keypoints.octave[before] = level;
        last_keypoints.angle[before] = angle;
        last_holder[at((b * cameras + c) * capacity + k_last)] =
            g.chance(3) ? points + 1 : (g.chance(10) ? g.below(points) : i);
      }
      if (seen_now.valid && g.chance(90)) {
        keypoints.x[now] = seen_now.pixel.x + g.real(-2, 2);
        keypoints.y[now] = seen_now.pixel.y + g.real(-2, 2);
        keypoints.octave[now] = std::min(7, std::max(0, level + g.from_to(-1, 1)));
        float const turned = angle - (g.chance(85) ? g.real(0, 8) : g.real(0, 300));
        keypoints.angle[now] = turned < 0 ? turned + 360 : turned;
        keypoints.orb[now] = g.flipped(look, g.below(60));
        numbers[c] = c * capacity + k;
        if (Rig::rectified && g.chance(70)) {
          float const z = (truth[at(b)] * world).z;
          right_x[at(b * capacity + k)] = keypoints.x[now] - 30 / z + g.real(-3, 3);
        }
      }
    }
    if (cameras == 2 && numbers[0] >= 0 && numbers[1] >= 0 && g.chance(60)) {
      partner[at(b * cameras * capacity + numbers[0])] = numbers[1];
      partner[at(b * cameras * capacity + numbers[1])] = numbers[0];
    }
  }
};

/// A tracking case in an executor's memory, and its stages.
template <typename Exec, typename Rig>
class stages_on {
public:
  static constexpr int cameras = cameras_of<Rig>;

  stages_on(Exec const& exec, tracking_case<Rig> const& c)
      : exec_(exec),
        case_(c),
        keypoints_(c.capacity, 2 * c.batch),
        last_keypoints_(c.capacity, 2 * c.batch),
        windows_capacity_(cameras * c.capacity) {
    memory_ = ft::arena<Exec::space>([&](ft::carver& k) {
      auto const points = at(c.batch) * at(c.points);
      auto const b = at(c.batch);
      ft::carve(k, map_, c.points, c.batch);
      ft::carve(k, grids_, ft::grid_geometry::over(0, 0, image_width, image_height), c.capacity,
                cameras * c.batch);
      ft::carve(k, windows_, windows_capacity_, c.batch, cameras);
      ft::carve(k, work_, windows_capacity_, c.capacity, c.batch, cameras);
      ft::carve(k, observations_, cameras * c.capacity, c.batch);
      last_ = k.template take<ft::pose>(b);
      predicted_ = k.template take<ft::pose>(b);
      result_ = k.template take<ft::pose>(b);
      last_holder_ = k.template take<int>(numbers());
      holder_ = k.template take<int>(numbers());
      right_x_ = k.template take<float>(c.right_x.size());
      partner_ = k.template take<int>(numbers());
      slots_ = k.template take<int>(at(c.batch) * at(windows_capacity_));
      slot_count_ = k.template take<int>(b);
      stamps_ = k.template take<int>(points);
      stamp_ = k.template take<int>(b);
      seen_ = k.template take<ft::visibility>(at(cameras) * at(c.batch) * at(windows_capacity_));
    });
    ft::fill_bytes(exec_, memory_.data(), 0, memory_.bytes());
    c.keypoints.upload(exec_, keypoints_.view());
    c.last_keypoints.upload(exec_, last_keypoints_.view());
    put(ft::array_of<ft::field::position>(map_), c.position);
    put(ft::array_of<ft::field::normal>(map_), c.normal);
    put(ft::array_of<ft::field::min_distance>(map_), c.min_distance);
    put(ft::array_of<ft::field::max_distance>(map_), c.max_distance);
    put(ft::array_of<ft::field::orb>(map_), c.orb);
    put(ft::array_of<ft::field::observations>(map_), c.observations);
    put(last_, c.last);
    put(predicted_, c.predicted);
    put(last_holder_, c.last_holder);
    put(right_x_, c.right_x);
    put(partner_, c.partner);
    put(slot_count_, c.slot_count);
    put(stamps_, c.stamps);
    put(stamp_, c.stamp);
    std::vector<int> slots(at(c.batch) * at(windows_capacity_), -1);
    for (int b = 0; b < c.batch; ++b) {
      std::copy_n(c.slots.begin() + b * c.points, c.points,
                  slots.begin() + static_cast<std::ptrdiff_t>(b) * windows_capacity_);
    }
    put(slots_, slots);
    exec_.wait();
    frame_.keypoints = keypoints_.view();
    frame_.cameras = cameras;
    frame_.batch = c.batch;
    frame_.grids = grids_;
    frame_.right_x = Rig::rectified ? right_x_ : nullptr;
    frame_.partner = Rig::rectified ? nullptr : partner_;
    frame_.holder = holder_;
    ft::build_grid<ft::nearest_cell>(exec_, keypoints_.view(), 0, cameras == 1 ? 2 : 1,
                                     cameras * c.batch, grids_);
  }

  record search_last(bool orientation_check, bool again) {
    ft::last_frame_view const last{last_keypoints_.view(), 2, cameras, last_holder_};
    ft::last_search_params params = case_.last_params;
    params.orientation_check = orientation_check;
    auto const run = [&](ft::last_search_params const& with) {
      ft::last_search<std::decay_t<decltype(case_.rig)>> const search{
          case_.rig, predicted_, last_, last, case_.geometry, with, {}};
      ft::search_last_frame(exec_, search, frame_, map_, {windows_, work_});
      return test::from_exec(exec_, static_cast<int const*>(holder_),
                             at(case_.batch) * at(frame_.numbers()));
    };
    auto const once = run(params);
    if (again) {  // those of the batch with fewer than the first, then, with twice the radius
      auto const first =
          test::from_exec(exec_, static_cast<int const*>(work_.matches), at(case_.batch));
      auto wider = params;
      wider.window_radius *= 2;
      auto const wide = run(wider);
      params.retry_below = first[0];
      auto const got = run(params);
      for (int b = 0; b < case_.batch; ++b) {
        auto const& want = first[at(b)] < first[0] ? wide : once;
        auto const begin = static_cast<std::ptrdiff_t>(b) * frame_.numbers();
        EXPECT_TRUE(std::equal(got.begin() + begin, got.begin() + begin + frame_.numbers(),
                               want.begin() + begin))
            << "entry " << b << " with " << first[at(b)] << " matches at first";
        repeated_ += static_cast<long>(first[at(b)] < first[0]);
      }
    }
    record r;
    add_windows(r);
    add_search(r);
    return r;
  }
  record find_visible() {
    using rig_type = std::decay_t<decltype(case_.rig)>;
    ft::local_search<rig_type> const search{case_.rig,      predicted_,         slots_,
                                            slot_count_,    {stamp_, stamps_},  case_.frustum,
                                            case_.geometry, case_.local_params, seen_};
    ft::find_visible_points(exec_, search, map_, windows_);
    record r;
    auto const all = test::from_exec(exec_, static_cast<ft::visibility const*>(seen_),
                                     at(cameras) * at(case_.batch) * at(windows_capacity_));
    for (int c = 0; c < cameras; ++c) {
      for (int b = 0; b < case_.batch; ++b) {
        auto const part =
            head(all, (static_cast<std::ptrdiff_t>(c) * case_.batch + b) * windows_capacity_,
                 case_.slot_count[at(b)]);
        r.add("visibility, camera " + std::to_string(c), part);
        for (auto const& v : part) { visible_ += static_cast<long>(v.level >= 0); }
      }
    }
    add_windows(r);
    return r;
  }
  record search_local(ft::search_params const& params) {
    ft::search_by_projection(exec_, frame_, map_, params, {windows_, work_});
    record r;
    add_search(r);
    return r;
  }
  /// Poses and flags. @param with_poses false: poses are compared elsewhere
  record optimize(bool with_poses) {
    ft::optimize_frame_poses(exec_, case_.rig, {frame_, map_, case_.geometry},
                             {predicted_, result_, observations_});
    record r;
    auto const b = at(case_.batch);
    auto const count = test::from_exec(exec_, static_cast<int const*>(observations_.count), b);
    r.add("observation counts", count);
    r.add("inlier counts",
          test::from_exec(exec_, static_cast<int const*>(observations_.inliers), b));
    if (with_poses) { r.add("poses", poses()); }
    auto const n = b * at(observations_.capacity);
    auto const flags =
        test::from_exec(exec_, static_cast<unsigned char const*>(observations_.outlier), n);
    auto const number = test::from_exec(exec_, static_cast<int const*>(observations_.number), n);
    for (int i = 0; i < case_.batch; ++i) {
      auto const first = static_cast<std::ptrdiff_t>(i) * observations_.capacity;
      r.add("outlier flags", head(flags, first, count[at(i)]));
      r.add("observed keypoints", head(number, first, count[at(i)]));
    }
    r.add("held after optimisation", holders());
    return r;
  }

  std::vector<ft::pose> poses() {
    return test::from_exec(exec_, static_cast<ft::pose const*>(result_), at(case_.batch));
  }
  std::vector<int> holders() {
    return test::from_exec(exec_, static_cast<int const*>(holder_), numbers());
  }
  std::vector<int> matches() {
    return test::from_exec(exec_, static_cast<int const*>(work_.matches), at(case_.batch));
  }
  std::vector<ft::search_window> windows() {
    return test::from_exec(exec_, static_cast<ft::search_window const*>(windows_.windows),
                           at(cameras) * at(case_.batch) * at(windows_capacity_));
  }
  long visible() const { return visible_; }
  long repeated() const { return repeated_; }
  /// Makes the next stage start from what another executor found.
  void take(std::vector<int> const& holders) { put(holder_, holders); }
  void take(std::vector<ft::search_window> const& windows) { put(windows_.windows, windows); }

private:
  template <typename T>
  void put(T* to, std::vector<T> const& values) {
    ft::copy(exec_, to, values.data(), values.size());
    exec_.wait();
  }
  std::size_t numbers() const { return at(cameras) * at(case_.batch) * at(case_.capacity); }

  /// Field by field: a window has padding.
  void add_windows(record& r) {
    auto const all = windows();
    auto const count =
        test::from_exec(exec_, static_cast<int const*>(windows_.count), at(case_.batch));
    r.add("window counts", count);
    for (int c = 0; c < cameras; ++c) {
      for (int b = 0; b < case_.batch; ++b) {
        std::vector<float> places;
        std::vector<int> rest;
        auto const first = (static_cast<std::ptrdiff_t>(c) * case_.batch + b) * windows_capacity_;
        for (auto const& w : head(all, first, count[at(b)])) {
          places.insert(places.end(), {w.x, w.y, w.radius, w.right_x});
          rest.insert(rest.end(),
                      {w.slot, w.min_level, w.max_level, static_cast<int>(w.check_right)});
        }
        r.add("window places, camera " + std::to_string(c), places);
        r.add("window slots and levels, camera " + std::to_string(c), rest);
      }
    }
  }
  void add_search(record& r) {
    r.add("held keypoints", holders());
    r.add("number of matches", matches());
    auto const count =
        test::from_exec(exec_, static_cast<int const*>(windows_.count), at(case_.batch));
    auto const match = test::from_exec(exec_, static_cast<int const*>(work_.match),
                                       at(cameras) * at(case_.batch) * at(windows_capacity_));
    for (int c = 0; c < cameras; ++c) {
      for (int b = 0; b < case_.batch; ++b) {
        r.add("match of each window",
              head(match, (static_cast<std::ptrdiff_t>(c) * case_.batch + b) * windows_capacity_,
                   count[at(b)]));
      }
    }
  }

  Exec exec_;
  tracking_case<Rig> const& case_;
  ft::keypoints<Exec::space> keypoints_, last_keypoints_;
  int windows_capacity_;
  ft::map_points_view map_;
  ft::feature_grid_view grids_;
  ft::search_windows_view windows_;
  ft::search_workspace work_;
  ft::observations_view observations_;
  ft::frame_view frame_;
  ft::pose* last_ = nullptr;
  ft::pose* predicted_ = nullptr;
  ft::pose* result_ = nullptr;
  int* last_holder_ = nullptr;
  int* holder_ = nullptr;
  float* right_x_ = nullptr;
  int* partner_ = nullptr;
  int* slots_ = nullptr;
  int* slot_count_ = nullptr;
  int* stamps_ = nullptr;
  int* stamp_ = nullptr;
  ft::visibility* seen_ = nullptr;
  ft::arena<Exec::space> memory_;
  long visible_ = 0;
  long repeated_ = 0;  ///< searches that found too little at first
};

/// True where two numbers are within 1e-9, or where floats cannot say so: neighbours.
bool near(float a, float b) {
  return std::abs(static_cast<double>(a) - static_cast<double>(b)) <= 1e-9 ||
         std::nextafter(a, b) == b;
}

void expect_near(std::vector<ft::pose> const& a, std::vector<ft::pose> const& b) {
  ASSERT_EQ(a.size(), b.size());
  for (std::size_t i = 0; i < a.size(); ++i) {
    for (int k = 0; k < 9; ++k) {
      EXPECT_TRUE(near(a[i].R.m[k], b[i].R.m[k])) << a[i].R.m[k] << " and " << b[i].R.m[k];
    }
    EXPECT_TRUE(near(a[i].t.x, b[i].t.x)) << a[i].t.x << " and " << b[i].t.x;
    EXPECT_TRUE(near(a[i].t.y, b[i].t.y)) << a[i].t.y << " and " << b[i].t.y;
    EXPECT_TRUE(near(a[i].t.z, b[i].t.z)) << a[i].t.z << " and " << b[i].t.z;
  }
}

/// Models whose formulas use the library's trigonometry may differ in the last bit of a double.
template <typename Rig>
constexpr bool exact_poses = Rig::rectified || std::is_same<Rig, pinhole_rig>::value;

struct tracking_totals {
  long last_matches = 0, local_matches = 0, visible = 0, held = 0, kept = 0, repeated = 0;
};

template <typename Rig>
void compare_tracking(executors& on, int cases, int most_points, unsigned first_seed,
                      tracking_totals& totals) {
  for (int i = 0; i < cases; ++i) {
    unsigned const seed = first_seed + static_cast<unsigned>(i);
    SCOPED_TRACE("seed " + std::to_string(seed));
    generator g(seed);
    tracking_case<Rig> const c(g, most_points);
    stages_on<ft::host_exec, Rig> a(on.first, c);
    stages_on<std::decay_t<decltype(on.second)>, Rig> b(on.second, c);
    auto const held = [](std::vector<int> const& h) {
      return static_cast<long>(std::count_if(h.begin(), h.end(), [](int v) { return v >= 0; }));
    };
    bool const again = g.chance(50);
    for (bool const orientation_check : {false, true}) {
      SCOPED_TRACE(std::string("search from the last frame") +
                   (orientation_check ? ", orientation check" : ""));
      expect_same_bits(a.search_last(orientation_check, again),
                       b.search_last(orientation_check, again));
    }
    for (int const m : a.matches()) { totals.last_matches += m; }
    totals.held += held(a.holders());
    b.take(a.holders());
    {
      SCOPED_TRACE("pose after the search from the last frame");
      expect_same_bits(a.optimize(exact_poses<Rig>), b.optimize(exact_poses<Rig>));
      expect_near(a.poses(), b.poses());
    }
    totals.kept += held(a.holders());
    b.take(a.holders());
    {
      SCOPED_TRACE("frustum");
      expect_same_bits(a.find_visible(), b.find_visible());
      totals.visible += a.visible();
      totals.repeated += a.repeated();
    }
    b.take(a.windows());
    ft::search_params params;
    if (g.chance(30)) { params.ratio = g.real(0.3f, 1.1f); }
    if (g.chance(30)) { params.max_hamming = g.below(200); }
    {
      SCOPED_TRACE("search in the local map");
      expect_same_bits(a.search_local(params), b.search_local(params));
    }
    for (int const m : a.matches()) { totals.local_matches += m; }
    b.take(a.holders());
    {
      SCOPED_TRACE("pose after the search in the local map");
      expect_same_bits(a.optimize(exact_poses<Rig>), b.optimize(exact_poses<Rig>));
      expect_near(a.poses(), b.poses());
    }
    if (::testing::Test::HasFailure()) { return; }
  }
}

void expect_worked(tracking_totals const& t, long least) {
  EXPECT_GT(t.last_matches, least);
  EXPECT_GT(t.local_matches, least);
  EXPECT_GT(t.visible, least);
  EXPECT_GT(t.repeated, 5);
  EXPECT_GT(t.kept, least / 2);
  EXPECT_LT(t.kept, t.held);  // there were outliers to let go of
}

TEST_F(stage_parity, tracking_with_a_rectified_pair) {
  executors on;
  tracking_totals totals;
  compare_tracking<ft::rectified_rig>(on, 60, 120, 1000, totals);
  compare_tracking<ft::rectified_rig>(on, 6, 2000, 1500, totals);
  expect_worked(totals, 1000);
}

TEST_F(stage_parity, tracking_with_a_fisheye_pair) {
  executors on;
  tracking_totals totals;
  compare_tracking<fisheye_rig>(on, 60, 120, 2000, totals);
  compare_tracking<fisheye_rig>(on, 6, 2000, 2500, totals);
  expect_worked(totals, 2000);
}

TEST_F(stage_parity, tracking_with_other_pairs) {
  executors on;
  tracking_totals totals;
  compare_tracking<pinhole_rig>(on, 30, 300, 3000, totals);
  compare_tracking<mixed_rig>(on, 30, 300, 3500, totals);
  expect_worked(totals, 2000);
}

// ---- pose from given observations -------------------------------------------------------------

/// One problem per item.
template <typename Rig>
struct solve_problem {
  using scratch = ft::detail::pose_scratch;

  template <typename Group>
  FT_HOST_DEVICE void operator()(Group g, scratch& s, int item, Rig const& rig,
                                 ft::pose_problem const& all, int const* first) const {
    int const from = first[item];
    ft::pose_problem const one{all.observations + from, first[item + 1] - from, all.start + item,
                               all.result + item,       all.outlier + from,     all.inliers + item};
    ft::detail::optimize_problem<Rig>{rig, {}}(g, s, item, one);
  }
};

template <typename Rig>
void compare_poses(executors& on, int problems, unsigned seed, long& inliers_found) {
  generator g(seed);
  Rig const rig = make_rig<Rig>(g);
  std::vector<ft::observation> observations;
  std::vector<int> first{0};
  std::vector<ft::pose> start;
  for (int i = 0; i < problems; ++i) {
    ft::pose const truth = small_motion(g, 3, 5);
    ft::pose const T_wc = truth.inverse();
    bool const hard = g.chance(20);
    start.push_back(small_motion(g, hard ? 1.0f : 0.03f, hard ? 2.0f : 0.1f) * truth);
    int const n = g.chance(30) ? g.below(6) : g.below(700);
    int const wrong = g.below(60);
    for (int k = 0; k < n; ++k) {
      ft::vec3<float> const p{g.real(-3, 3), g.real(-2, 2),
                              g.chance(2) ? g.real(-3, 0) : g.real(1, 12)};
      int const c = cameras_of<Rig> == 2 ? g.below(2) : 0;
      auto const seen = see(rig, c, p);
      ft::observation o{T_wc * p,
                        seen.pixel.x,
                        seen.pixel.y,
                        -1.0f,
                        1.0f / std::pow(1.44f, static_cast<float>(g.below(8))),
                        c};
      if (Rig::rectified && g.chance(60)) {
        o.right_u = std::max(0.0f, o.u - 40 / p.z + g.real(-1, 1));
      }
      float const error = g.chance(wrong) ? 60.0f : 1.0f;
      o.u += g.real(-error, error);
      o.v += g.real(-error, error);
      if (g.chance(1)) { o.u = std::numeric_limits<float>::quiet_NaN(); }
      observations.push_back(o);
    }
    first.push_back(static_cast<int>(observations.size()));
  }
  struct answer {
    record rest;
    std::vector<ft::pose> poses;
  };
  auto const run = [&](auto const& exec) {
    constexpr auto space = std::decay_t<decltype(exec)>::space;
    auto const d_observations = test::to_exec(exec, observations);
    auto const d_first = test::to_exec(exec, first);
    auto const d_start = test::to_exec(exec, start);
    ft::buffer<ft::pose, space> const result(start.size());
    ft::buffer<unsigned char, space> const outlier(observations.size());
    ft::buffer<int, space> const inliers(start.size());
    ft::for_each_item<ft::per_block<ft::sum_lanes>>(
        exec, problems, solve_problem<Rig>{}, rig,
        ft::pose_problem{d_observations.data(), first.back(), d_start.data(), result.data(),
                         outlier.data(), inliers.data()},
        static_cast<int const*>(d_first.data()));
    answer r;
    r.poses = test::from_exec(exec, static_cast<ft::pose const*>(result.data()), start.size());
    r.rest.add("flags", test::from_exec(exec, static_cast<unsigned char const*>(outlier.data()),
                                        observations.size()));
    auto const counts =
        test::from_exec(exec, static_cast<int const*>(inliers.data()), start.size());
    r.rest.add("inliers", counts);
    if (exact_poses<Rig>) { r.rest.add("poses", r.poses); }
    for (int const n : counts) { inliers_found += n; }
    return r;
  };
  auto const a = run(on.first);
  auto const b = run(on.second);
  expect_same_bits(a.rest, b.rest);
  expect_near(a.poses, b.poses);
}

TEST_F(stage_parity, poses_from_any_observations) {
  executors on;
  long inliers = 0;
  for (unsigned seed = 0; seed < 4; ++seed) {
    SCOPED_TRACE("seed " + std::to_string(seed));
    {
      SCOPED_TRACE("rectified pair");
      compare_poses<ft::rectified_rig>(on, 40, 4000 + seed, inliers);
    }
    {
      SCOPED_TRACE("pair of pinholes");
      compare_poses<pinhole_rig>(on, 20, 4100 + seed, inliers);
    }
    {
      SCOPED_TRACE("fisheye pair");
      compare_poses<fisheye_rig>(on, 20, 4200 + seed, inliers);
    }
    if (HasFailure()) { return; }
  }
  EXPECT_GT(inliers, 10000);
}

// ---- stereo of two cameras without rectification ----------------------------------------------

template <typename Rig>
void compare_fisheye_stereo(executors& on, unsigned seed, long& found) {
  generator g(seed);
  Rig const rig = make_rig<Rig>(g);
  int const pairs = g.from_to(1, 3);
  int const capacity = g.from_to(1, 500);
  auto const geometry = ft::pyramid_geometry::make(752, 480, 8, 1.2f);
  loose_keypoints kp(g, capacity, 2 * pairs, image_width, image_height, 8, false);
  std::vector<int> mono;
  for (int p = 0; p < pairs; ++p) {
    for (int i = 0; i < capacity; ++i) {
      ft::vec3<float> const point{g.real(-3, 3), g.real(-2, 2), g.real(0.3f, 12)};
      auto const look = g.descriptor();
      for (int c = 0; c < 2; ++c) {
        auto const k = at((2 * p + c) * capacity + (c == 0 ? i : (i * 7) % capacity));
        auto const seen = see(rig, c, point);
        if (!seen.valid || g.chance(15)) { continue; }
        float const error = g.chance(10) ? 20.0f : 1.0f;
        kp.x[k] = seen.pixel.x + g.real(-error, error);
        kp.y[k] = seen.pixel.y + g.real(-error, error);
        kp.orb[k] = g.flipped(look, g.below(50));
      }
    }
    for (int c = 0; c < 2; ++c) { mono.push_back(g.below(kp.count[at(2 * p + c)] / 2 + 1)); }
  }
  auto const run = [&](auto const& exec) {
    using exec_type = std::decay_t<decltype(exec)>;
    ft::keypoints<exec_type::space> keypoints(capacity, 2 * pairs);
    kp.upload(exec, keypoints.view());
    auto const d_mono = test::to_exec(exec, mono);
    ft::fisheye_matches_view out;
    ft::arena<exec_type::space> const memory(
        [&](ft::carver& c) { ft::carve(c, out, capacity, pairs); });
    ft::fisheye_stereo<std::decay_t<decltype(rig)>> const stereo{rig, geometry, d_mono.data(), {}};
    ft::match_stereo_fisheye(exec, stereo, keypoints.view(), out);
    record r;
    auto const depth =
        test::from_exec(exec, static_cast<float const*>(out.depth), at(pairs * capacity));
    r.add("partners",
          test::from_exec(exec, static_cast<int const*>(out.partner), at(2 * pairs * capacity)));
    r.add("depth", depth);
    r.add("points", test::from_exec(exec, static_cast<ft::vec3<float> const*>(out.point),
                                    at(pairs * capacity)));
    found += std::count_if(depth.begin(), depth.end(), [](float d) { return d > 0; });
    return r;
  };
  expect_same_bits(run(on.first), run(on.second));
}

TEST_F(stage_parity, unrectified_stereo_of_any_keypoints) {
  executors on;
  long found = 0;
  for (unsigned seed = 0; seed < 20; ++seed) {
    SCOPED_TRACE("seed " + std::to_string(seed));
    compare_fisheye_stereo<fisheye_rig>(on, 5000 + seed, found);
    compare_fisheye_stereo<mixed_rig>(on, 5100 + seed, found);
    if (HasFailure()) { return; }
  }
  EXPECT_GT(found, 500);
}

// ---- the whole tracker ------------------------------------------------------------------------

struct tracker_case {
  int width, height, batch, features;
  unsigned seed;
};

/// Three frames: the first makes the map from its stereo depth, the others are tracked. Images move
/// by a few pixels; what comes out need not be a true motion, only the same.
template <typename Exec, typename Rig>
std::vector<record> run_tracker(Exec const& exec, Rig const& rig, tracker_case const& c,
                                long& matched) {
  ft::tracker_params params;
  params.orb.width = c.width;
  params.orb.height = c.height;
  params.orb.features = c.features;
  params.map_slots = 3 * c.features;
  params.local_points = 2 * c.features;
  params.updates = 2 * c.features;
  ft::frame_tracker<Exec, Rig> tracker(exec, rig, params, c.batch);
  int const capacity = tracker.capacity();
  int const numbers = tracker.cameras * capacity;
  test::frame_inputs in(tracker);
  std::vector<record> all;
  auto const keep = [&](bool local) {
    exec.wait();
    auto const& r = tracker.result();
    record now;
    auto const add = [&](char const* name, auto const* data, int length) {
      now.add(name, std::vector<std::decay_t<decltype(*data)>>(
                        data, data + static_cast<std::ptrdiff_t>(c.batch) * length));
    };
    add("keypoints", r.keypoints, r.cameras);
    add("matches", r.matches, 1);
    add("inliers", r.inliers, 1);
    add("poses", r.T_cw, 1);
    add("x", r.x, numbers);
    add("y", r.y, numbers);
    add("octave", r.octave, numbers);
    add("holder", r.holder, numbers);
    add("partner", r.partner, numbers);
    add("depth", r.depth, capacity);
    add("point", r.point, capacity);
    if (local) { add("in view", r.in_view, r.local_points); }
    all.push_back(now);
    for (int b = 0; b < c.batch; ++b) { matched += r.matches[b]; }
  };
  std::vector<image> left;
  for (int b = 0; b < c.batch; ++b) {
    left.push_back(test::random_image(c.width, c.height, c.seed + 10 * static_cast<unsigned>(b)));
  }
  for (int frame = 0; frame < 3; ++frame) {
    for (int b = 0; b < c.batch; ++b) {
      auto const seed = c.seed + 100u * static_cast<unsigned>(frame) + static_cast<unsigned>(b);
      if (frame > 0) { left[at(b)] = shifted(left[at(b)], c.width, c.height, 3, 1, seed); }
      image const right =
          shifted(left[at(b)], c.width, c.height, 25, 0, c.seed + static_cast<unsigned>(b));
      tracker.set_image(b, 0, {left[at(b)].data(), c.width, c.height, c.width});
      tracker.set_image(b, 1, {right.data(), c.width, c.height, c.width});
    }
    if (frame == 0) {
      in.extract(exec);
      keep(false);
      for (int b = 0; b < c.batch; ++b) {
        auto const& r = tracker.result();
        int const count = r.keypoints[b * r.cameras];
        std::vector<ft::descriptor> orb(at(count));
        tracker.download_descriptors(exec, b, orb.data(), count);
        exec.wait();
        all.back().add("descriptors", orb);
        std::vector<ft::point_update> points;
        int* const holder = in.last_holder.data() + static_cast<std::ptrdiff_t>(b) * numbers;
        int* const local =
            in.local_slots.data() + static_cast<std::ptrdiff_t>(b) * params.local_points;
        for (int i = 0; i < count; ++i) {
          auto const p = r.point[b * capacity + i];
          if (!(p.z > 0)) { continue; }
          float const distance = std::sqrt(ft::dot(p, p));
          float const most = distance * tracker.geometry().scale[r.octave[b * numbers + i]];
          local[points.size()] = i;
          points.push_back({i,
                            1 + i % 3,
                            p,
                            {p.x / distance, p.y / distance, p.z / distance},
                            most / 3.6f,
                            most,
                            orb[at(i)]});
          if (i % 3 != 0) { holder[i] = i; }
        }
        in.local_count[at(b)] = static_cast<int>(points.size());
        tracker.update_map(exec, b, points.data(), static_cast<int>(points.size()));
        exec.wait();
      }
      continue;
    }
    in.track_motion(exec);
    keep(false);
    in.track_local(exec);
    keep(true);
    in.relocalize(exec, {2, 0});
    keep(true);
    std::copy_n(tracker.result().holder, c.batch * numbers, in.last_holder.begin());
    std::copy_n(tracker.result().T_cw, c.batch, in.last_pose.begin());
    in.predicted = in.last_pose;
  }
  return all;
}

template <typename Rig>
void compare_trackers(executors& on, Rig const& rig, tracker_case const& c, long& matched) {
  SCOPED_TRACE(std::to_string(c.width) + "x" + std::to_string(c.height) + ", batch " +
               std::to_string(c.batch));
  long again = 0;
  auto const a = run_tracker(on.first, rig, c, matched);
  auto const b = run_tracker(on.second, rig, c, again);
  ASSERT_EQ(a.size(), b.size());
  for (std::size_t i = 0; i < a.size(); ++i) {
    SCOPED_TRACE("call " + std::to_string(i));
    expect_same_bits(a[i], b[i]);
  }
}

TEST_F(stage_parity, whole_tracker_of_rectified_pairs) {
  executors on;
  long matched = 0;
  auto const rig = ft::rectified_rig::make({400, 405, 320, 200}, 0.1f);
  compare_trackers(on, rig, {640, 400, 1, 800, 61}, matched);
  compare_trackers(on, rig, {333, 257, 3, 400, 62}, matched);
  compare_trackers(on, rig, {752, 480, 2, 1200, 63}, matched);
  EXPECT_GT(matched, 500);
}

TEST_F(stage_parity, whole_tracker_of_unrectified_pairs) {
  executors on;
  long matched = 0;
  ft::pose const T_rl{ft::mat3<float>::identity(), {-0.1f, 0, 0}};
  pinhole_rig const rig{{400, 400, 320, 200}, {400, 400, 320, 200}, T_rl};
  compare_trackers(on, rig, {640, 400, 2, 800, 71}, matched);
  EXPECT_GT(matched, 100);
}

}  // namespace stages_parity
