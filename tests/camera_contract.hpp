// SPDX-License-Identifier: Apache-2.0
/// @file What a camera model must do to work in ft, as tests that a user runs on a model of hers.
///
/// Describe the model in one structure and name it, at global scope of one source file:
///
///     struct my_lens : camera_contract::description<my_model> {
///       static constexpr int width = 640, height = 480;
///       static my_model<double> parameters() { return {...}; }   // a real calibration
///     };
///     FT_CAMERA_CONTRACT(my_model, my_lens);
///
/// Compiled as C++ the tests run on the host; as CUDA on host and GPU, and the two are compared bit
/// for bit. Without a device the GPU's tests skip, with FT_REQUIRE_GPU=1 in the environment they
/// fail. A program is compiled by one of the two compilers, not by both. Needs ft and GoogleTest.
#pragma once

#include <gtest/gtest.h>

#include <algorithm>
#include <cmath>
#include <cstddef>
#include <cstdint>
#include <cstdlib>
#include <cstring>
#include <functional>
#include <limits>
#include <memory>
#include <random>
#include <string>
#include <vector>

#include "ft/cameras/camera_model.hpp"
#include "ft/cameras/stereo_rig.hpp"
#include "ft/containers/feature_grid.hpp"
#include "ft/containers/fisheye_matches.hpp"
#include "ft/containers/frame.hpp"
#include "ft/containers/image_pyramid.hpp"
#include "ft/containers/keypoints.hpp"
#include "ft/containers/map_points.hpp"
#include "ft/core/execution.hpp"
#include "ft/core/memory.hpp"
#include "ft/kernels/grid.hpp"
#include "ft/kernels/pose/optimize_frame.hpp"
#include "ft/kernels/search/frustum.hpp"
#include "ft/kernels/search/last_frame.hpp"
#include "ft/kernels/search/windows.hpp"
#include "ft/kernels/search/workspace.hpp"
#include "ft/kernels/stereo/fisheye.hpp"
#include "ft/pipelines/frame_tracker.hpp"

namespace camera_contract {
inline namespace FT_ABI {

// ---- what the user says of her model ----------------------------------------------------------

/// Base of a description; the user adds `width`, `height` (pixels) and `parameters()`, and hides
/// with her own what does not fit.
template <template <typename> class Model>
struct description {
  template <typename Scalar>
  using camera = Model<Scalar>;

  /// True where directions behind the plane z = 0 have a valid pixel; false: none has one.
  static constexpr bool sees_behind = false;
  /// An angle off the axis that a model which sees behind does see, degrees.
  static constexpr double behind_degrees = 95;
  /// Least share of the image's pixels that have a valid ray.
  static constexpr double least_share = 0.9;
  /// How far a pixel may be off after a round trip, in double and in float, pixels. Coordinates
  /// up to 1000 have a spacing of 6e-5 in float.
  static constexpr double double_pixels = 1e-8;
  static constexpr double float_pixels = 1e-3;
};

// ---- executors --------------------------------------------------------------------------------

struct host_executor {
  using exec_type = ft::host_exec;
  static constexpr char const* name = "host";
  exec_type exec{};
  static bool available() { return true; }
};

#if defined(__CUDACC__)
struct cuda_executor {
  using exec_type = ft::cuda_exec;
  static constexpr char const* name = "cuda";
  exec_type exec;

  cuda_executor() : exec(make()) {}
  cuda_executor(cuda_executor const&) = delete;
  cuda_executor& operator=(cuda_executor const&) = delete;
  ~cuda_executor() { cudaStreamDestroy(exec.stream); }

  static bool available() {
    int devices = 0;
    bool const found = cudaGetDeviceCount(&devices) == cudaSuccess && devices > 0;
    cudaGetLastError();
    char const* const require = std::getenv("FT_REQUIRE_GPU");
    if (!found && require != nullptr && std::string(require) == "1") {
      ADD_FAILURE() << "FT_REQUIRE_GPU=1 but there is no CUDA device";
    }
    return found;
  }

private:
  static ft::cuda_exec make() {
    cudaStream_t stream = nullptr;
    EXPECT_EQ(cudaStreamCreateWithFlags(&stream, cudaStreamNonBlocking), cudaSuccess);
    return ft::cuda_exec(stream);
  }
};
#endif

/// A copy of `values` in an executor's memory.
template <typename T, typename Exec>
ft::buffer<T, Exec::space> to_exec(Exec const& exec, std::vector<T> const& values) {
  ft::buffer<T, Exec::space> memory(values.size());
  ft::copy(exec, memory.data(), values.data(), values.size());
  exec.wait();
  return memory;
}
template <typename T, typename Exec>
std::vector<T> from_exec(Exec const& exec, T const* data, std::size_t count) {
  std::vector<T> values(count);
  ft::copy(exec, values.data(), data, count);
  exec.wait();
  return values;
}

/// Executor and description of a suite.
template <typename Executor, typename Description>
struct setting {
  using executor = Executor;
  using lens = Description;
};
struct executor_name {
  template <typename Setting>
  static std::string GetName(int) {
    return Setting::executor::name;
  }
};

#if defined(__CUDACC__)
template <typename Description>
using settings =
    ::testing::Types<setting<host_executor, Description>, setting<cuda_executor, Description>>;
template <typename Description>
using gpu_settings = ::testing::Types<setting<cuda_executor, Description>>;
#else
template <typename Description>
using settings = ::testing::Types<setting<host_executor, Description>>;
#endif

// ---- geometry, in double ----------------------------------------------------------------------

using vector = ft::vec3<double>;
using motion = ft::rigid<double>;
inline constexpr double pi = 3.14159265358979323846;
inline constexpr double nan = std::numeric_limits<double>::quiet_NaN();
inline constexpr double infinity = std::numeric_limits<double>::infinity();

inline std::size_t at(std::ptrdiff_t i) { return static_cast<std::size_t>(i); }
inline double length(vector v) { return std::sqrt(ft::dot(v, v)); }
inline vector scaled(vector v, double s) { return {v.x * s, v.y * s, v.z * s}; }
/// Between two directions of any length, radians; accurate where it is small.
inline double angle_between(vector a, vector b) {
  vector const cross{a.y * b.z - a.z * b.y, a.z * b.x - a.x * b.z, a.x * b.y - a.y * b.x};
  return std::atan2(length(cross), ft::dot(a, b));
}
/// @param polar off the axis @param azimuth about it; radians
inline vector direction(double polar, double azimuth) {
  return {std::sin(polar) * std::cos(azimuth), std::sin(polar) * std::sin(azimuth),
          std::cos(polar)};
}
/// Rotation by `angle` about an axis, then a translation.
inline motion turn(vector axis, double angle, vector t) {
  vector const a = scaled(axis, 1 / length(axis));
  double const c = std::cos(angle);
  double const s = std::sin(angle);
  double const d = 1 - c;
  return {{{c + a.x * a.x * d, a.x * a.y * d - a.z * s, a.x * a.z * d + a.y * s,
            a.y * a.x * d + a.z * s, c + a.y * a.y * d, a.y * a.z * d - a.x * s,
            a.z * a.x * d - a.y * s, a.z * a.y * d + a.x * s, c + a.z * a.z * d}},
          t};
}
inline vector random_direction(std::mt19937& random) {
  std::normal_distribution<double> gauss;
  double const x = gauss(random);
  double const y = gauss(random);
  return {x, y, gauss(random)};
}

// ---- a model, asked through an executor -------------------------------------------------------

/// Numbers are exchanged as double: exact for every scalar.
struct question {
  vector point;
  ft::vec2<double> pixel;
};
struct sight {
  ft::vec2<double> pixel;
  int valid;
  bool usable() const { return valid != 0 && std::isfinite(pixel.x) && std::isfinite(pixel.y); }
};
struct lift {
  vector direction;
  int valid;
};
struct answer {
  sight of_point;       ///< project(point)
  sight with_jacobian;  ///< project_with_jacobian(point)
  lift back;            ///< unproject(project(point))
  lift of_pixel;        ///< unproject(pixel)
  sight again;          ///< project(unproject(pixel))
  double jacobian[6];   ///< at the point
};

template <typename Camera>
struct answer_question {
  using scratch = ft::no_scratch;
  using scalar = typename Camera::scalar_type;
  using plain = ft::plain_scalar_t<scalar>;

  template <typename Group>
  FT_HOST_DEVICE void operator()(Group, scratch&, int i, Camera const& camera,
                                 question const* questions, answer* out) const {
    question const q = questions[i];
    ft::vec3<scalar> const p{scalar(static_cast<plain>(q.point.x)),
                             scalar(static_cast<plain>(q.point.y)),
                             scalar(static_cast<plain>(q.point.z))};
    auto const seen = camera.project(p);
    auto const both = camera.project_with_jacobian(p);
    auto const ray = camera.unproject(
        {scalar(static_cast<plain>(q.pixel.x)), scalar(static_cast<plain>(q.pixel.y))});
    answer a{};
    a.of_point = wide(seen);
    a.with_jacobian = wide(both.value);
    a.back = wide(camera.unproject(seen.pixel));
    a.of_pixel = wide(ray);
    a.again = wide(camera.project(ray.direction));
    for (int k = 0; k < 6; ++k) { a.jacobian[k] = wide(both.jacobian.m[k]); }
    out[i] = a;
  }

private:
  FT_HOST_DEVICE static double wide(scalar v) { return static_cast<double>(ft::to_plain(v)); }
  FT_HOST_DEVICE static sight wide(ft::projection<scalar> const& p) {
    return {{wide(p.pixel.x), wide(p.pixel.y)}, static_cast<int>(p.valid)};
  }
  FT_HOST_DEVICE static lift wide(ft::ray<scalar> const& r) {
    return {{wide(r.direction.x), wide(r.direction.y), wide(r.direction.z)},
            static_cast<int>(r.valid)};
  }
};

/// A camera holds its parameters and nothing else, so it is an array of them.
template <typename Camera>
double parameter(Camera const& camera, int i) {
  using plain = ft::plain_scalar_t<typename Camera::scalar_type>;
  plain value{};
  std::memcpy(&value, reinterpret_cast<unsigned char const*>(&camera) + at(i) * sizeof(plain),
              sizeof(plain));
  return static_cast<double>(value);
}
template <typename Camera>
Camera with_parameter(Camera camera, int i, double value) {
  using plain = ft::plain_scalar_t<typename Camera::scalar_type>;
  auto const v = static_cast<plain>(value);
  std::memcpy(reinterpret_cast<unsigned char*>(&camera) + at(i) * sizeof(plain), &v, sizeof(plain));
  return camera;
}

/// A model behind functions: what is computed from it is compiled once for all models.
struct double_camera {
  std::function<ft::projection<double>(vector)> project;
  std::function<ft::ray<double>(ft::vec2<double>)> unproject;
  int width, height;

  bool in_image(ft::vec2<double> p, double margin = 0) const {
    return p.x >= margin && p.x <= width - margin && p.y >= margin && p.y <= height - margin;
  }
  /// Pixels per radian next to the axis; the smaller of the two directions.
  double focal() const {
    constexpr double h = 1e-4;
    return std::min(project({h, 0, 1}).pixel.x - project({-h, 0, 1}).pixel.x,
                    project({0, h, 1}).pixel.y - project({0, -h, 1}).pixel.y) /
           (2 * h);
  }
};

template <typename Setting>
class on_executor : public ::testing::Test {
protected:
  using executor = typename Setting::executor;
  using exec_type = typename executor::exec_type;
  using lens = typename Setting::lens;
  template <typename Scalar>
  using model_of = typename lens::template camera<Scalar>;

  void SetUp() override {
    if (!executor::available()) { GTEST_SKIP() << "no CUDA device"; }
    executor_ = std::make_unique<executor>();
  }
  exec_type const& exec() const { return executor_->exec; }

  /// The model in double, with the parameters as floats have them.
  static model_of<double> model() {
    return lens::parameters().template cast<float>().template cast<double>();
  }
  static double_camera functions() {
    auto const c = model();
    return {[c](vector p) { return c.project(p); },
            [c](ft::vec2<double> p) { return c.unproject(p); }, lens::width, lens::height};
  }

  template <typename Scalar>
  std::vector<answer> ask(std::vector<question> const& questions) const {
    auto const c = model().template cast<Scalar>();
    auto const input = to_exec(exec(), questions);
    auto const out = to_exec(exec(), std::vector<answer>(questions.size(), answer{}));
    ft::for_each_item<ft::per_thread>(exec(), static_cast<int>(questions.size()),
                                      answer_question<model_of<Scalar>>{}, c,
                                      static_cast<question const*>(input.data()), out.data());
    return from_exec(exec(), static_cast<answer const*>(out.data()), questions.size());
  }

  /// All over the image, its rim included.
  static std::vector<question> pixels(double beyond = 0) {
    std::vector<question> all;
    for (int y = 0; y <= 24; ++y) {
      for (int x = 0; x <= 24; ++x) {
        double const u = (x / 24.0 * (1 + 2 * beyond) - beyond) * (lens::width - 1);
        double const v = (y / 24.0 * (1 + 2 * beyond) - beyond) * (lens::height - 1);
        all.push_back({{0, 0, 1}, {u, v}});
      }
    }
    return all;
  }
  /// Points near and far, in all directions that the image shows.
  static std::vector<question> points() {
    std::vector<question> all;
    auto const c = functions();
    for (auto const& q : pixels()) {
      auto const r = c.unproject(q.pixel);
      if (!r.valid) { continue; }
      for (double const distance : {0.3, 5.0, 80.0}) {
        all.push_back({scaled(r.direction, distance / length(r.direction)), q.pixel});
      }
    }
    return all;
  }
  static std::vector<question> in_directions(std::vector<vector> const& directions) {
    std::vector<question> all;
    for (auto const& d : directions) { all.push_back({d, {1, 1}}); }
    return all;
  }

private:
  std::unique_ptr<executor> executor_;
};

template <typename Setting>
class camera_model : public on_executor<Setting> {
protected:
  using base = on_executor<Setting>;
  using lens = typename base::lens;

  template <typename Scalar>
  void check_round_trip(double tolerance) {
    auto const questions = base::pixels();
    auto const got = this->template ask<Scalar>(questions);
    std::size_t valid = 0;
    for (std::size_t i = 0; i < got.size(); ++i) {
      if (got[i].of_pixel.valid == 0) { continue; }
      ++valid;
      auto const& p = questions[i].pixel;
      ASSERT_EQ(got[i].again.valid, 1) << "the ray of " << p.x << ", " << p.y << " has no pixel";
      ASSERT_NEAR(got[i].again.pixel.x, p.x, tolerance) << p.x << ", " << p.y;
      ASSERT_NEAR(got[i].again.pixel.y, p.y, tolerance) << p.x << ", " << p.y;
    }
    EXPECT_GE(static_cast<double>(valid), lens::least_share * static_cast<double>(got.size()))
        << "pixels of the image that have a ray";
  }

  template <typename Scalar>
  void check_rays(double pixels) {
    double const tolerance = 10 * pixels / base::functions().focal();
    auto questions = base::points();
    std::size_t const shown = questions.size();
    std::mt19937 random(1);
    for (int i = 0; i < 1000; ++i) { questions.push_back({random_direction(random), {1, 1}}); }
    auto const c = base::functions();
    auto const got = this->template ask<Scalar>(questions);
    for (std::size_t i = 0; i < got.size(); ++i) {
      auto const& p = questions[i].point;
      if (i < shown) {
        ASSERT_EQ(got[i].of_point.valid, 1) << p.x << ", " << p.y << ", " << p.z;
        ASSERT_EQ(got[i].back.valid, 1) << p.x << ", " << p.y << ", " << p.z;
      } else if (got[i].of_point.valid == 0 || !c.in_image(got[i].of_point.pixel) ||
                 got[i].back.valid == 0) {
        continue;
      }
      ASSERT_LT(angle_between(got[i].back.direction, p), tolerance)
          << "the point " << p.x << ", " << p.y << ", " << p.z << " is seen at "
          << got[i].of_point.pixel.x << ", " << got[i].of_point.pixel.y << ", whose ray is "
          << got[i].back.direction.x << ", " << got[i].back.direction.y << ", "
          << got[i].back.direction.z;
    }
  }

  template <typename Scalar>
  void check_behind() {
    std::vector<vector> straight{{0, 0, -1}, {0, 0, -5}, {0, 0, 0}};
    std::vector<vector> behind;
    std::mt19937 random(2);
    for (int i = 0; i < 300; ++i) {
      vector d = random_direction(random);
      d.z = i < 20 ? 0 : -std::abs(d.z);
      behind.push_back(d);
    }
    for (auto const& a : this->template ask<Scalar>(base::in_directions(straight))) {
      EXPECT_EQ(a.of_point.valid, 0) << "straight behind, and in the centre, no pixel is right";
      EXPECT_TRUE(std::isfinite(a.of_point.pixel.x) && std::isfinite(a.of_point.pixel.y));
    }
    auto const got = this->template ask<Scalar>(base::in_directions(behind));
    for (std::size_t i = 0; i < got.size(); ++i) {
      auto const& seen = got[i].of_point;
      if (!lens::sees_behind) { ASSERT_EQ(seen.valid, 0) << "z = " << behind[i].z; }
      ASSERT_TRUE(std::isfinite(seen.pixel.x) && std::isfinite(seen.pixel.y))
          << "a pixel that is not valid is still a number; z = " << behind[i].z;
    }
    if (!lens::sees_behind) { return; }
    std::vector<vector> seen;
    for (int i = 0; i < 8; ++i) {
      seen.push_back(direction(lens::behind_degrees * pi / 180, i * pi / 4));
    }
    for (auto const& a : this->template ask<Scalar>(base::in_directions(seen))) {
      EXPECT_EQ(a.of_point.valid, 1) << lens::behind_degrees << " degrees off the axis";
    }
  }

  template <typename Scalar>
  void check_outward_walk(double slack) {
    constexpr int azimuths = 36;
    constexpr int steps = 719;
    std::vector<vector> walk{{0, 0, 1}};
    for (int a = 0; a < azimuths; ++a) {
      for (int s = 1; s <= steps; ++s) {
        walk.push_back(direction(s * pi / (steps + 1), a * 2 * pi / azimuths));
      }
    }
    auto const got = this->template ask<Scalar>(base::in_directions(walk));
    auto const centre = got[0].of_point.pixel;
    for (int a = 0; a < azimuths; ++a) {
      double farthest = 0;
      double its_degrees = 0;
      for (int s = 1; s <= steps; ++s) {
        auto const& seen = got[at(1 + a * steps + s - 1)].of_point;
        double const degrees = 180.0 * s / (steps + 1);
        ASSERT_TRUE(std::isfinite(seen.pixel.x) && std::isfinite(seen.pixel.y)) << degrees;
        if (seen.valid == 0) { continue; }
        double const radius = std::hypot(seen.pixel.x - centre.x, seen.pixel.y - centre.y);
        ASSERT_GT(radius, farthest - slack)
            << degrees << " degrees off the axis a valid pixel is no farther out than at "
            << its_degrees << ": two directions share it (azimuth " << a * 360 / azimuths << ")";
        farthest = radius;
        its_degrees = degrees;
      }
    }
  }

  template <typename Scalar>
  void check_points_without_a_number() {
    std::vector<vector> bad;
    for (double const v : {nan, infinity, -infinity}) {
      for (double const z : {-1.0, 0.0, 1.0}) {
        for (vector const p : {vector{v, 0.2, z}, {0.1, v, z}, {v, v, z}, {v, 0, z}}) {
          bad.push_back(p);
        }
      }
      bad.push_back({v, v, v});
    }
    for (vector const p : {vector{0.1, 0.2, nan},
                           {0, 0, nan},
                           {0.1, 0.2, -infinity},
                           {infinity, 0.1, infinity},
                           {nan, 0.1, infinity}}) {
      bad.push_back(p);
    }
    auto const got = this->template ask<Scalar>(base::in_directions(bad));
    for (std::size_t i = 0; i < bad.size(); ++i) {
      EXPECT_FALSE(got[i].of_point.usable())
          << bad[i].x << ", " << bad[i].y << ", " << bad[i].z << " became the pixel "
          << got[i].of_point.pixel.x << ", " << got[i].of_point.pixel.y;
    }
    // Infinitely far ahead is on the axis, or nowhere.
    auto const far = this->template ask<Scalar>(base::in_directions({{0, 0, 1}, {1, 1, infinity}}));
    if (far[1].of_point.usable()) {
      EXPECT_EQ(far[1].of_point.pixel.x, far[0].of_point.pixel.x);
      EXPECT_EQ(far[1].of_point.pixel.y, far[0].of_point.pixel.y);
    }
  }

  template <typename Scalar>
  void check_pixels_without_a_number() {
    std::vector<question> bad;
    for (double const v : {nan, infinity, -infinity}) {
      for (ft::vec2<double> const p : {ft::vec2<double>{v, 1}, {1, v}, {v, v}}) {
        bad.push_back({{0, 0, 1}, p});
      }
    }
    auto const got = this->template ask<Scalar>(bad);
    for (std::size_t i = 0; i < bad.size(); ++i) {
      EXPECT_EQ(got[i].of_pixel.valid, 0) << bad[i].pixel.x << ", " << bad[i].pixel.y;
    }
  }

  template <typename Scalar>
  void check_refusals() {
    auto const good = base::model().template cast<Scalar>();
    EXPECT_NO_THROW(good.check());
    auto const refused = [&](int i, double value) {
      EXPECT_THROW(with_parameter(good, i, value).check(), ft::bad_argument)
          << "parameter " << i << " = " << value;
    };
    for (int i = 0; i < 2; ++i) {
      for (double const focal : {0.0, -1.0, 1e9}) { refused(i, focal); }
    }
    using model = typename base::template model_of<Scalar>;
    for (int i = 0; i < ft::num_params_v<model>; ++i) {
      for (double const value : {nan, infinity, -infinity}) { refused(i, value); }
      // The limits are in double; a float next to one is beyond it by more than a rounding.
      auto const& limits = model::parameters.of[i];
      double const both[] = {limits.low, limits.high};
      for (double const limit : both) {
        if (!std::isfinite(limit)) { continue; }
        double const beyond = 1e-3 * (1 + std::abs(limit));
        refused(i, limit == limits.low ? limit - beyond : limit + beyond);
      }
    }
  }
};
TYPED_TEST_SUITE_P(camera_model);

TYPED_TEST_P(camera_model, keeps_the_contract) {
  EXPECT_TRUE(ft::is_camera_model_v<typename TestFixture::template model_of<float>>);
  EXPECT_TRUE(ft::is_camera_model_v<typename TestFixture::template model_of<double>>);
  EXPECT_TRUE(ft::is_camera_model_v<typename TestFixture::template model_of<ft::strict_float>>);
  EXPECT_TRUE(ft::is_camera_model_v<typename TestFixture::template model_of<ft::strict_double>>);
  EXPECT_GT(std::string(TestFixture::template model_of<float>::name).size(), 0u);
}

TYPED_TEST_P(camera_model, holds_its_parameters_and_nothing_else) {
  using narrow = typename TestFixture::template model_of<float>;
  using wide = typename TestFixture::template model_of<double>;
  using strict = typename TestFixture::template model_of<ft::strict_float>;
  ASSERT_GE(ft::num_params_v<narrow>, 4);
  EXPECT_EQ(sizeof(narrow), sizeof(float) * static_cast<std::size_t>(ft::num_params_v<narrow>));
  EXPECT_EQ(sizeof(wide), sizeof(double) * static_cast<std::size_t>(ft::num_params_v<wide>));
  EXPECT_EQ(sizeof(strict), sizeof(float) * static_cast<std::size_t>(ft::num_params_v<strict>));
}

TYPED_TEST_P(camera_model, the_first_parameters_are_fx_fy_cx_cy) {
  auto const c = TestFixture::model();
  vector const p{0.1, 0.07, 1};
  auto const seen = c.project(p).pixel;
  double const u = seen.x - parameter(c, 2);
  double const v = seen.y - parameter(c, 3);
  auto const near = [&](int i, double by, double want_u, double want_v) {
    auto const other = with_parameter(c, i, i < 2 ? parameter(c, i) * by : parameter(c, i) + by);
    auto const got = other.project(p).pixel;
    EXPECT_NEAR(got.x, want_u, 1e-9) << "parameter " << i;
    EXPECT_NEAR(got.y, want_v, 1e-9) << "parameter " << i;
  };
  near(0, 2, seen.x + u, seen.y);
  near(1, 2, seen.x, seen.y + v);
  near(2, 3, seen.x + 3, seen.y);
  near(3, 3, seen.x, seen.y + 3);
}

TYPED_TEST_P(camera_model, a_cast_keeps_the_parameters) {
  auto const in_float = TestFixture::lens::parameters().template cast<float>();
  auto const there = in_float.template cast<double>().template cast<ft::strict_double>();
  auto const back = there.template cast<ft::strict_float>().template cast<float>();
  EXPECT_EQ(std::memcmp(&back, &in_float, sizeof back), 0);
  auto const c = TestFixture::lens::parameters();
  for (int i = 0; i < ft::num_params_v<typename TestFixture::template model_of<float>>; ++i) {
    EXPECT_EQ(parameter(in_float, i), static_cast<double>(static_cast<float>(parameter(c, i))))
        << "parameter " << i;
  }
}

TYPED_TEST_P(camera_model, calibrations_that_cannot_be_throw) {
  this->template check_refusals<float>();
  this->template check_refusals<double>();
}

TYPED_TEST_P(camera_model, a_pixel_survives_the_round_trip) {
  using data = typename TestFixture::lens;
  this->template check_round_trip<double>(data::double_pixels);
  this->template check_round_trip<ft::strict_double>(data::double_pixels);
  this->template check_round_trip<float>(data::float_pixels);
  this->template check_round_trip<ft::strict_float>(data::float_pixels);
}

TYPED_TEST_P(camera_model, a_pixel_outside_the_image_has_its_own_ray_or_none) {
  auto const questions = TestFixture::pixels(1.5);
  auto const got = this->template ask<double>(questions);
  double const tolerance = 1e3 * TestFixture::lens::double_pixels;
  for (std::size_t i = 0; i < got.size(); ++i) {
    if (got[i].of_pixel.valid == 0) { continue; }
    auto const& p = questions[i].pixel;
    ASSERT_EQ(got[i].again.valid, 1) << p.x << ", " << p.y;
    ASSERT_NEAR(got[i].again.pixel.x, p.x, tolerance) << p.x << ", " << p.y;
    ASSERT_NEAR(got[i].again.pixel.y, p.y, tolerance) << p.x << ", " << p.y;
  }
}

TYPED_TEST_P(camera_model, a_ray_points_at_its_point) {
  using data = typename TestFixture::lens;
  this->template check_rays<double>(data::double_pixels);
  this->template check_rays<ft::strict_double>(data::double_pixels);
  this->template check_rays<float>(data::float_pixels);
  this->template check_rays<ft::strict_float>(data::float_pixels);
}

TYPED_TEST_P(camera_model, float_and_double_agree) {
  auto const questions = TestFixture::points();
  auto const wide = this->template ask<double>(questions);
  auto const narrow = this->template ask<float>(questions);
  auto const strict = this->template ask<ft::strict_float>(questions);
  double const tolerance = TestFixture::lens::float_pixels;
  for (std::size_t i = 0; i < questions.size(); ++i) {
    for (sight const& got : std::vector<sight>{narrow[i].of_point, strict[i].of_point}) {
      ASSERT_EQ(got.valid, wide[i].of_point.valid);
      ASSERT_NEAR(got.pixel.x, wide[i].of_point.pixel.x, tolerance);
      ASSERT_NEAR(got.pixel.y, wide[i].of_point.pixel.y, tolerance);
    }
  }
}

TYPED_TEST_P(camera_model, the_jacobian_is_the_derivative) {
  using data = typename TestFixture::lens;
  auto questions = TestFixture::points();
  for (vector const p : {vector{0, 0, 2}, {1e-7, -2e-7, 1}, {1e-4, 3e-5, 1}}) {
    questions.push_back({p, {1, 1}});
  }
  if (data::sees_behind) {
    questions.push_back({direction((90 + data::behind_degrees) / 2 * pi / 180, 0.3), {1, 1}});
  }
  auto const c = TestFixture::model();
  auto const got = this->template ask<double>(questions);
  auto const narrow = this->template ask<float>(questions);
  for (std::size_t i = 0; i < questions.size(); ++i) {
    vector const p = questions[i].point;
    double const h = 1e-6 * length(p);
    double numeric[6];
    double largest = 0;
    for (int k = 0; k < 3; ++k) {
      vector ahead = p;
      vector behind = p;
      (k == 0 ? ahead.x : k == 1 ? ahead.y : ahead.z) += h;
      (k == 0 ? behind.x : k == 1 ? behind.y : behind.z) -= h;
      auto const a = c.project(ahead).pixel;
      auto const b = c.project(behind).pixel;
      numeric[k] = (a.x - b.x) / (2 * h);
      numeric[3 + k] = (a.y - b.y) / (2 * h);
      largest = std::max({largest, std::abs(numeric[k]), std::abs(numeric[3 + k])});
    }
    for (std::size_t k = 0; k < 6; ++k) {
      ASSERT_NEAR(got[i].jacobian[k], numeric[k], 1e-6 * largest)
          << "entry " << k << " at " << p.x << ", " << p.y << ", " << p.z;
      ASSERT_NEAR(narrow[i].jacobian[k], got[i].jacobian[k], 1e-4 * largest)
          << "entry " << k << " in float at " << p.x << ", " << p.y << ", " << p.z;
    }
  }
}

TYPED_TEST_P(camera_model, the_jacobian_comes_with_the_projection) {
  using data = typename TestFixture::lens;
  auto questions = TestFixture::points();
  std::mt19937 random(5);
  for (int i = 0; i < 300; ++i) { questions.push_back({random_direction(random), {1, 1}}); }
  for (double const bad : {nan, infinity}) { questions.push_back({{bad, 0.1, 1}, {1, 1}}); }
  auto const expect_agreement = [](std::vector<answer> const& got, double tolerance) {
    for (answer const& a : got) {
      ASSERT_EQ(a.with_jacobian.usable(), a.of_point.usable());
      if (!a.of_point.usable()) { continue; }
      ASSERT_NEAR(a.with_jacobian.pixel.x, a.of_point.pixel.x, tolerance);
      ASSERT_NEAR(a.with_jacobian.pixel.y, a.of_point.pixel.y, tolerance);
    }
  };
  expect_agreement(this->template ask<double>(questions), data::double_pixels);
  expect_agreement(this->template ask<ft::strict_double>(questions), data::double_pixels);
  expect_agreement(this->template ask<float>(questions), data::float_pixels);
  expect_agreement(this->template ask<ft::strict_float>(questions), data::float_pixels);
}

TYPED_TEST_P(camera_model, the_axis_is_seen_at_the_principal_point) {
  auto const c = TestFixture::model();
  question const q{{0, 0, 2}, {parameter(c, 2), parameter(c, 3)}};
  std::vector<answer> const answers{this->template ask<double>({q})[0],
                                    this->template ask<float>({q})[0],
                                    this->template ask<ft::strict_float>({q})[0]};
  for (answer const& got : answers) {
    EXPECT_EQ(got.of_point.valid, 1);
    EXPECT_NEAR(got.of_point.pixel.x, q.pixel.x, 1e-4);
    EXPECT_NEAR(got.of_point.pixel.y, q.pixel.y, 1e-4);
    EXPECT_EQ(got.of_pixel.valid, 1);
    EXPECT_LT(angle_between(got.of_pixel.direction, {0, 0, 1}), 1e-6);
    for (double const entry : got.jacobian) { EXPECT_TRUE(std::isfinite(entry)); }
  }
}

TYPED_TEST_P(camera_model, behind_the_camera) {
  this->template check_behind<double>();
  this->template check_behind<float>();
  this->template check_behind<ft::strict_float>();
}

TYPED_TEST_P(camera_model, no_two_directions_share_a_pixel) {
  this->template check_outward_walk<double>(0);
  this->template check_outward_walk<ft::strict_float>(TestFixture::lens::float_pixels);
}

TYPED_TEST_P(camera_model, a_point_that_is_no_number_has_no_pixel) {
  this->template check_points_without_a_number<float>();
  this->template check_points_without_a_number<ft::strict_float>();
  this->template check_points_without_a_number<double>();
}

TYPED_TEST_P(camera_model, a_pixel_that_is_no_number_has_no_ray) {
  this->template check_pixels_without_a_number<float>();
  this->template check_pixels_without_a_number<ft::strict_float>();
  this->template check_pixels_without_a_number<double>();
}

TYPED_TEST_P(camera_model, a_very_far_or_near_point_has_its_own_pixel_or_none) {
  auto const questions = TestFixture::points();
  for (double const scale : {1e-6, 1e6, 1e30}) {
    auto moved = questions;
    for (auto& q : moved) { q.point = scaled(q.point, scale); }
    auto const got = this->template ask<float>(moved);
    auto const want = this->template ask<double>(questions);
    for (std::size_t i = 0; i < got.size(); ++i) {
      if (!got[i].of_point.usable()) { continue; }
      ASSERT_NEAR(got[i].of_point.pixel.x, want[i].of_point.pixel.x,
                  TestFixture::lens::float_pixels)
          << "at " << scale << " times the distance";
      ASSERT_NEAR(got[i].of_point.pixel.y, want[i].of_point.pixel.y,
                  TestFixture::lens::float_pixels)
          << "at " << scale << " times the distance";
    }
  }
}

REGISTER_TYPED_TEST_SUITE_P(camera_model, keeps_the_contract, holds_its_parameters_and_nothing_else,
                            the_first_parameters_are_fx_fy_cx_cy, a_cast_keeps_the_parameters,
                            calibrations_that_cannot_be_throw, a_pixel_survives_the_round_trip,
                            a_pixel_outside_the_image_has_its_own_ray_or_none,
                            a_ray_points_at_its_point, float_and_double_agree,
                            the_jacobian_is_the_derivative, the_jacobian_comes_with_the_projection,
                            the_axis_is_seen_at_the_principal_point, behind_the_camera,
                            no_two_directions_share_a_pixel, a_point_that_is_no_number_has_no_pixel,
                            a_pixel_that_is_no_number_has_no_ray,
                            a_very_far_or_near_point_has_its_own_pixel_or_none);

#if defined(__CUDACC__)

// ---- host against GPU -------------------------------------------------------------------------

template <typename Setting>
class camera_on_gpu : public on_executor<Setting> {};
TYPED_TEST_SUITE_P(camera_on_gpu);

/// The same bits; any NaN is as good as another.
inline bool same(double a, double b) {
  return (std::isnan(a) && std::isnan(b)) || (a == b && std::signbit(a) == std::signbit(b));
}

inline bool same(vector a, vector b) { return same(a.x, b.x) && same(a.y, b.y) && same(a.z, b.z); }

TYPED_TEST_P(camera_on_gpu, strict_floats_are_the_same_bits_as_on_the_host) {
  using camera = typename TestFixture::template model_of<ft::strict_float>;
  std::mt19937 random(3);
  std::uniform_real_distribution<double> unit(-1, 2);
  auto questions = TestFixture::points();
  for (int i = 0; i < 20000; ++i) {
    question q{random_direction(random),
               {unit(random) * TestFixture::lens::width, unit(random) * TestFixture::lens::height}};
    if (i % 4 == 0) { q.point.z = std::abs(q.point.z); }
    if (i % 50 == 0) { q.point.x = q.point.y = 0; }
    if (i % 50 == 1) { q.point.z = 0; }
    q.point = scaled(q.point, std::pow(10.0, i % 7 - 2));
    questions.push_back(q);
  }
  auto const got = this->template ask<ft::strict_float>(questions);
  auto const c = TestFixture::model().template cast<ft::strict_float>();
  std::vector<answer> want(questions.size());
  ft::for_each_item<ft::per_thread>(ft::host_exec(1), static_cast<int>(questions.size()),
                                    answer_question<camera>{}, c,
                                    static_cast<question const*>(questions.data()), want.data());
  for (std::size_t i = 0; i < questions.size(); ++i) {
    auto const& a = got[i];
    auto const& b = want[i];
    auto const& p = questions[i].point;
    ASSERT_TRUE(a.of_point.valid == b.of_point.valid && a.back.valid == b.back.valid &&
                a.of_pixel.valid == b.of_pixel.valid && a.again.valid == b.again.valid)
        << "validity at " << p.x << ", " << p.y << ", " << p.z;
    ASSERT_TRUE(same(a.of_point.pixel.x, b.of_point.pixel.x) &&
                same(a.of_point.pixel.y, b.of_point.pixel.y) &&
                same(a.with_jacobian.pixel.x, b.with_jacobian.pixel.x) &&
                same(a.with_jacobian.pixel.y, b.with_jacobian.pixel.y) &&
                same(a.again.pixel.x, b.again.pixel.x) && same(a.again.pixel.y, b.again.pixel.y))
        << "pixel of " << p.x << ", " << p.y << ", " << p.z;
    ASSERT_TRUE(same(a.back.direction, b.back.direction)) << "ray back to the point";
    ASSERT_TRUE(same(a.of_pixel.direction, b.of_pixel.direction))
        << "ray of " << questions[i].pixel.x << ", " << questions[i].pixel.y;
    for (std::size_t k = 0; k < 6; ++k) {
      ASSERT_TRUE(same(a.jacobian[k], b.jacobian[k]))
          << "Jacobian at " << p.x << ", " << p.y << ", " << p.z;
    }
  }
}

REGISTER_TYPED_TEST_SUITE_P(camera_on_gpu, strict_floats_are_the_same_bits_as_on_the_host);

#endif

// ---- scenes for the stages, with a pair of the described cameras
// ---------------------------------

/// One of 512 descriptors, any two of them 128 bits apart or all 256.
inline ft::descriptor code(int number) {
  ft::descriptor d{};
  for (unsigned bit = 0; bit < 256; ++bit) {
    auto const n = static_cast<unsigned>(number);
    unsigned const set = (static_cast<unsigned>(ft::popcount(n & bit & 255u)) ^ n >> 8) & 1u;
    d.words[bit / 32] |= set << (bit % 32);
  }
  return d;
}

/// A keypoint of a scene: where a point is seen by one camera.
struct mark {
  int point;
  ft::vec2<double> pixel;
};

/// Points in front of a pair of cameras, and where they are seen: from the model's projection in
/// double alone. Poses and points are rounded to float before anything is computed from them.
struct scene {
  ft::pose T_cw;                          ///< true
  ft::pose T_rl;                          ///< left to right camera
  std::vector<ft::vec3<float>> points;    ///< world
  std::vector<vector> in_left, in_right;  ///< the points in the cameras' frames
  std::vector<mark> left, right;          ///< keypoints: left ones in order, right ones reversed
  double margin = 0;                      ///< no keypoint is this near to the image's rim, pixels
};

inline ft::pose rig_motion() {
  return turn({0.1, 1, 0.2}, 0.03, {-0.3, 0.004, 0.002}).cast<float>();
}

/// @param seen points that the left camera sees, at most 84 degrees off its axis
/// @param unseen points behind both cameras
inline scene make_scene(double_camera const& camera, int seen, int unseen, unsigned seed) {
  std::mt19937 random(seed);
  std::uniform_real_distribution<double> unit(0, 1);
  scene s;
  s.T_cw = turn({0.3, -0.7, 0.2}, 0.8, {0.5, -0.2, 1.1}).cast<float>();
  s.T_rl = rig_motion();
  s.margin = 2 + std::max(camera.width, camera.height) / 64.0;
  auto const T_cw = s.T_cw.cast<double>();
  auto const T_wc = T_cw.inverse();
  auto const add = [&](vector p) {
    vector const w = T_wc * p;
    s.points.push_back({static_cast<float>(w.x), static_cast<float>(w.y), static_cast<float>(w.z)});
    auto const& r = s.points.back();
    s.in_left.push_back(T_cw * vector{r.x, r.y, r.z});
    s.in_right.push_back(s.T_rl.cast<double>() * s.in_left.back());
  };
  for (int i = 0; static_cast<int>(s.points.size()) < seen && i < 100 * seen; ++i) {
    ft::vec2<double> const pixel{s.margin + 1 + unit(random) * (camera.width - 2 * s.margin - 2),
                                 s.margin + 1 + unit(random) * (camera.height - 2 * s.margin - 2)};
    auto const r = camera.unproject(pixel);
    double const distance = 1.5 + 4 * unit(random);
    if (!r.valid || !(r.direction.z > 0.1 * length(r.direction))) { continue; }
    add(scaled(r.direction, distance / length(r.direction)));
  }
  EXPECT_EQ(static_cast<int>(s.points.size()), seen) << "too few pixels have a ray ahead";
  for (int i = 0; i < unseen; ++i) {
    vector d = random_direction(random);
    d.z = -std::abs(d.z) - 0.3 * length(d);
    add(scaled(d, (1.5 + 4 * unit(random)) / length(d)));
  }
  for (int i = 0; i < static_cast<int>(s.points.size()); ++i) {
    auto const l = camera.project(s.in_left[at(i)]);
    auto const r = camera.project(s.in_right[at(i)]);
    if (i >= seen) { continue; }
    EXPECT_TRUE(l.valid && camera.in_image(l.pixel, s.margin));
    s.left.push_back({i, l.pixel});
    if (r.valid && camera.in_image(r.pixel, s.margin)) {
      s.right.insert(s.right.begin(), {i, r.pixel});
    }
  }
  EXPECT_GE(static_cast<int>(s.right.size()), seen / 3) << "the cameras see too little in common";
  return s;
}

inline ft::pyramid_geometry scene_geometry(int width, int height) {
  return ft::pyramid_geometry::make(width, height, 8, 1.2f);
}

/// A scene in an executor's memory: point i is in slot i, keypoints hold what `holder` says.
template <typename Exec>
struct stage_frame {
  static constexpr ft::memory_space space = Exec::space;
  int capacity;
  ft::pyramid_geometry geometry;
  ft::map_points<space> map;
  ft::keypoints<space> keypoints;
  ft::feature_grid<space> grids;
  ft::buffer<int, space> holder;
  ft::frame_view view;

  stage_frame(Exec const& exec, scene const& s, int width, int height,
              std::vector<int> const& holders = {})
      : capacity(static_cast<int>(s.points.size())),
        geometry(scene_geometry(width, height)),
        map(capacity),
        keypoints(capacity, 2),
        grids(ft::grid_geometry::over(0, 0, static_cast<float>(width), static_cast<float>(height)),
              capacity, 2),
        holder(to_exec(exec, holders.empty() ? std::vector<int>(at(2 * capacity), -1) : holders)) {
    auto const T_wc = s.T_cw.cast<double>().inverse();
    ft::map_points<ft::memory_space::host> const points(capacity);
    ft::keypoints<ft::memory_space::host> const marks(capacity, 2);
    auto const p = points.view();
    *p.count = capacity;
    for (int i = 0; i < capacity; ++i) {
      auto const& w = s.points[at(i)];
      vector const from = vector{w.x, w.y, w.z} - T_wc.t;
      double const distance = length(from);
      p.position(i) = w;
      p.normal(i) = {static_cast<float>(from.x / distance), static_cast<float>(from.y / distance),
                     static_cast<float>(from.z / distance)};
      p.min_distance(i) = 0.1f;
      p.max_distance(i) = 100.0f;
      p.orb(i) = code(i);
      p.observations(i) = 1;
    }
    for (int c = 0; c < 2; ++c) {
      auto const& seen = c == 0 ? s.left : s.right;
      auto const k = marks.view().slice(c);
      *k.count = static_cast<int>(seen.size());
      for (int i = 0; i < capacity; ++i) {
        bool const there = i < *k.count;
        mark const m = there ? seen[at(i)] : mark{0, {0, 0}};
        k.x(i) = static_cast<float>(m.pixel.x);
        k.y(i) = static_cast<float>(m.pixel.y);
        k.angle(i) = 0;
        k.response(i) = 1;
        k.octave(i) = 0;
        k.orb(i) = there ? code(m.point) : ft::descriptor{};
      }
    }
    ft::copy(exec, map.view(), points.view());
    ft::copy(exec, keypoints.view(), marks.view());
    ft::build_grid<ft::nearest_cell>(exec, keypoints.view(), 0, 1, 2, grids.view());
    exec.wait();
    view.keypoints = keypoints.view();
    view.keypoint_step = 2;
    view.cameras = 2;
    view.grids = grids.view();
    view.holder = holder.data();
  }
  std::vector<int> holders(Exec const& exec) const {
    return from_exec(exec, static_cast<int const*>(holder.data()), at(2 * capacity));
  }
};

/// Slot held by each keypoint where every keypoint holds its own point: [2 * capacity].
inline std::vector<int> own_points(scene const& s) {
  std::size_t const capacity = s.points.size();
  std::vector<int> holders(2 * capacity, -1);
  for (std::size_t i = 0; i < s.left.size(); ++i) { holders[i] = s.left[i].point; }
  for (std::size_t i = 0; i < s.right.size(); ++i) { holders[capacity + i] = s.right[i].point; }
  return holders;
}

/// Whether a camera has the point in view, from the projection in double.
enum class expected { seen, unseen, doubtful };
inline expected in_view(double_camera const& camera, vector p) {
  auto const here = camera.project(p);
  double const size = length(p);
  if (std::abs(p.z) < 1e-4 * size) { return expected::doubtful; }
  if (p.z < 0) { return expected::unseen; }
  for (vector const step : {vector{1, 0, 0}, {0, 1, 0}, {0, 0, 1}}) {
    for (double const h : {-1e-4 * size, 1e-4 * size}) {
      if (camera.project(p + scaled(step, h)).valid != here.valid) { return expected::doubtful; }
    }
  }
  if (!here.valid || !camera.in_image(here.pixel, -0.02)) { return expected::unseen; }
  return camera.in_image(here.pixel, 0.02) ? expected::seen : expected::doubtful;
}

/// What each window and camera should find: [2 * count].
inline std::vector<expected> expected_views(double_camera const& camera, scene const& s) {
  std::vector<expected> all;
  for (vector const& p : s.in_left) { all.push_back(in_view(camera, p)); }
  for (vector const& p : s.in_right) { all.push_back(in_view(camera, p)); }
  return all;
}

/// Puts half of a scene's points elsewhere, all around the cameras.
inline void scatter(scene& s, unsigned seed) {
  std::mt19937 random(seed);
  auto const T_wc = s.T_cw.cast<double>().inverse();
  for (std::size_t i = 0; i < s.points.size(); i += 2) {
    vector const d = random_direction(random);
    vector const w = T_wc * scaled(d, 3 / length(d));
    s.points[i] = {static_cast<float>(w.x), static_cast<float>(w.y), static_cast<float>(w.z)};
    s.in_left[i] = s.T_cw.cast<double>() * vector{s.points[i].x, s.points[i].y, s.points[i].z};
    s.in_right[i] = s.T_rl.cast<double>() * s.in_left[i];
  }
}

/// Parallax of a point seen by both cameras, radians.
inline double parallax(scene const& s, int i) {
  vector const r = s.T_rl.cast<double>().R.transposed() * s.in_right[at(i)];
  return angle_between(s.in_left[at(i)], r);
}

/// Largest difference of entries.
inline double difference(ft::pose const& a, ft::pose const& b) {
  double worst = std::max({std::abs(static_cast<double>(a.t.x) - b.t.x),
                           std::abs(static_cast<double>(a.t.y) - b.t.y),
                           std::abs(static_cast<double>(a.t.z) - b.t.z)});
  for (int i = 0; i < 9; ++i) {
    double const entry = std::abs(static_cast<double>(a.R.m[i]) - b.R.m[i]);
    worst = entry <= worst ? worst : entry;  // also a NaN
  }
  return worst;
}

// ---- a room to look at --------------------------------------------------------------------------

using image = std::vector<std::uint8_t>;

/// Rectangles of all sizes and some noise; the same for the same seed.
inline image texture(int side, unsigned seed) {
  std::mt19937 random(seed);
  image t(at(side * side), 90);
  auto const draw = [&](int n) { return static_cast<int>(random() % static_cast<unsigned>(n)); };
  for (int i = 0; i < 150; ++i) {
    int const w = 2 + draw(side / (2 + i % 40));
    int const h = 2 + draw(side / (2 + i % 40));
    int const x0 = draw(side);
    int const y0 = draw(side);
    int const grey = draw(256);
    for (int y = y0; y < std::min(side, y0 + h); ++y) {
      for (int x = x0; x < std::min(side, x0 + w); ++x) {
        t[at(y * side + x)] = static_cast<std::uint8_t>(grey);
      }
    }
  }
  for (auto& v : t) { v = static_cast<std::uint8_t>(std::clamp(v + draw(9) - 4, 0, 255)); }
  return t;
}

/// A box around the origin of the world with a texture on each wall.
class room {
public:
  room() {
    for (unsigned w = 0; w < 6; ++w) { walls_.push_back(texture(side, 70 + w)); }
  }
  /// From a place inside to the wall, in lengths of `d`. @param wall its number
  static double distance(vector from, vector d, int& wall) {
    double const origin[3] = {from.x, from.y, from.z};
    double const towards[3] = {d.x, d.y, d.z};
    double nearest = 1e9;
    for (int a = 0; a < 3; ++a) {
      if (std::abs(towards[a]) < 1e-12) { continue; }
      double const t = ((towards[a] > 0 ? high[a] : low[a]) - origin[a]) / towards[a];
      if (t < nearest) {
        nearest = t;
        wall = 2 * a + static_cast<int>(towards[a] > 0);
      }
    }
    return nearest;
  }
  /// @param rays one per pixel, in the camera's frame; length 0 = none, painted grey
  image render(std::vector<vector> const& rays, motion const& T_cw) const {
    motion const T_wc = T_cw.inverse();
    image out(rays.size(), 90);
    for (std::size_t i = 0; i < rays.size(); ++i) {
      vector const d = T_wc.R * rays[i];
      if (!(length(d) > 0)) { continue; }
      int wall = 0;
      vector const hit = T_wc.t + scaled(d, distance(T_wc.t, d, wall));
      double const p[3] = {hit.x, hit.y, hit.z};
      double const s = (p[(wall / 2 + 1) % 3] + 20) * texels;
      double const t = (p[(wall / 2 + 2) % 3] + 20) * texels;
      int const x = static_cast<int>(s);
      int const y = static_cast<int>(t);
      auto const texel = [&](int u, int v) {
        return static_cast<double>(walls_[at(wall)][at(v % side * side + u % side)]);
      };
      double const fx = s - x;
      double const fy = t - y;
      out[i] = static_cast<std::uint8_t>(
          (1 - fx) * (1 - fy) * texel(x, y) + fx * (1 - fy) * texel(x + 1, y) +
          (1 - fx) * fy * texel(x, y + 1) + fx * fy * texel(x + 1, y + 1) + 0.5);
    }
    return out;
  }

private:
  static constexpr int side = 400;
  static constexpr double texels = 50;  // per metre
  static constexpr double low[3] = {-3, -1.5, -2};
  static constexpr double high[3] = {3, 1.5, 6};
  std::vector<image> walls_;
};

/// Two stereo frames of the room.
struct walk {
  ft::pose T_cw[2];  ///< true
  image left[2], right[2];
};

inline walk make_walk(double_camera const& camera) {
  std::vector<vector> rays;
  for (int y = 0; y < camera.height; ++y) {
    for (int x = 0; x < camera.width; ++x) {
      auto const r = camera.unproject({static_cast<double>(x), static_cast<double>(y)});
      rays.push_back(r.valid ? r.direction : vector{0, 0, 0});
    }
  }
  room const box;
  walk w;
  w.T_cw[0] = turn({0, 1, 0}, 0.2, {0.1, 0.05, 0.2}).cast<float>();
  w.T_cw[1] =
      (turn({0.4, 1, 0}, 0.014, {0.02, -0.01, -0.05}) * w.T_cw[0].cast<double>()).cast<float>();
  for (int f = 0; f < 2; ++f) {
    auto const T_cw = w.T_cw[f].cast<double>();
    w.left[f] = box.render(rays, T_cw);
    w.right[f] = box.render(rays, rig_motion().cast<double>() * T_cw);
  }
  return w;
}

/// A frame of a tracker as the host reads it; left keypoints.
struct tracked {
  int keypoints = 0, inliers = 0;
  ft::pose T_cw{};
  std::vector<float> x, y, depth;
  std::vector<int> octave, partner;
  std::vector<ft::vec3<float>> point;
  std::vector<ft::descriptor> orb;
};

/// Triangulated points of a frame against the walls that its pixels' rays meet.
inline void check_depths(double_camera const& camera, tracked const& frame, ft::pose const& T_cw) {
  auto const T_wc = T_cw.cast<double>().inverse();
  auto const T_rl = rig_motion().cast<double>();
  vector const right_centre = T_rl.centre();
  std::vector<double> errors;  // as what a pixel off in one image does, times so many
  for (std::size_t i = 0; i < at(frame.keypoints); ++i) {
    auto const r = camera.unproject({frame.x[i], frame.y[i]});
    if (!(frame.depth[i] > 0) || !r.valid) { continue; }
    int wall = 0;
    double const along = room::distance(T_wc.t, T_wc.R * r.direction, wall);
    vector const p = scaled(r.direction, along);
    auto const& got = frame.point[i];
    double const off = length(vector{got.x, got.y, got.z} - p) / length(p);
    errors.push_back(off * camera.focal() * std::sin(angle_between(p, p - right_centre)));
  }
  ASSERT_GE(errors.size(), 100u) << "stereo matches of " << frame.keypoints << " keypoints";
  std::nth_element(errors.begin(), errors.begin() + static_cast<std::ptrdiff_t>(errors.size() / 2),
                   errors.end());
  EXPECT_LT(errors[errors.size() / 2], 2) << "median error of triangulated points, in pixels";
}

/// Map points of a frame: slot i is left keypoint i.
inline std::vector<ft::point_update> map_of(tracked const& frame, ft::pose const& T_cw,
                                            ft::pyramid_geometry const& geometry) {
  ft::pose const T_wc = T_cw.inverse();
  std::vector<ft::point_update> points;
  for (int i = 0; i < frame.keypoints; ++i) {
    if (!(frame.depth[at(i)] > 0)) { continue; }
    ft::vec3<float> const p = T_wc * frame.point[at(i)];
    ft::vec3<float> const d = p - T_wc.t;
    float const distance = std::sqrt(ft::dot(d, d));
    float const farthest = distance * geometry.scale[frame.octave[at(i)]];
    points.push_back({i,
                      1,
                      p,
                      {d.x / distance, d.y / distance, d.z / distance},
                      farthest / geometry.scale[geometry.levels - 1],
                      farthest,
                      frame.orb[at(i)]});
  }
  return points;
}

inline void check_pose(double_camera const& camera, tracked const& frame, ft::pose const& want) {
  // Keypoints lie on whole pixels of their level; 3 pixels at 3 metres is far more than 40 leave.
  double const radians = 3 / camera.focal();
  auto const off = frame.T_cw.cast<double>() * want.cast<double>().inverse();
  vector const axis{off.R.m[7] - off.R.m[5], off.R.m[2] - off.R.m[6], off.R.m[3] - off.R.m[1]};
  EXPECT_LT(length(axis) / 2, radians) << "rotation, radians";
  EXPECT_LT(length(off.t), 3 * radians) << "translation, metres";
  EXPECT_GE(frame.inliers, 40) << "map points found";
}

template <typename Setting>
class camera_in_stages : public on_executor<Setting> {
protected:
  using base = on_executor<Setting>;
  using lens = typename base::lens;
  using exec_type = typename base::exec_type;
  using model_type = typename base::template model_of<float>;
  using rig_type = ft::stereo_rig<model_type, model_type>;
  static constexpr ft::memory_space space = exec_type::space;

  static rig_type rig() {
    auto const c = lens::parameters().template cast<float>();
    return {c, c, rig_motion()};
  }
  stage_frame<exec_type> load(scene const& s, std::vector<int> const& holders = {}) const {
    return stage_frame<exec_type>(this->exec(), s, lens::width, lens::height, holders);
  }
  /// Rendered once per program.
  static walk const& frames() {
    static walk const w = make_walk(base::functions());
    return w;
  }

  template <typename Tracker>
  tracked take(Tracker const& tracker) const {
    auto const& r = tracker.result();
    tracked t;
    t.keypoints = r.keypoints[0];
    t.inliers = r.inliers[0];
    t.T_cw = r.T_cw[0];
    auto const n = at(t.keypoints);
    t.x.assign(r.x, r.x + n);
    t.y.assign(r.y, r.y + n);
    t.depth.assign(r.depth, r.depth + n);
    t.octave.assign(r.octave, r.octave + n);
    t.partner.assign(r.partner, r.partner + n);
    t.point.assign(r.point, r.point + n);
    t.orb.resize(n);
    tracker.download_descriptors(this->exec(), 0, t.orb.data(), t.keypoints);
    this->exec().wait();
    return t;
  }
};
TYPED_TEST_SUITE_P(camera_in_stages);

TYPED_TEST_P(camera_in_stages, points_are_visible_where_they_project_into_the_image) {
  auto const camera = TestFixture::functions();
  auto s = make_scene(camera, 400, 0, 11);
  scatter(s, 12);
  auto const want = expected_views(camera, s);
  auto const frame = this->load(s);
  auto const& exec = this->exec();
  int const n = frame.capacity;
  ft::search_windows_view windows;
  ft::arena<TestFixture::space> const memory([&](ft::carver& c) { carve(c, windows, n, 1, 2); });
  std::vector<int> slots;
  for (int i = 0; i < n; ++i) { slots.push_back(i); }
  auto const poses = to_exec(exec, std::vector<ft::pose>{s.T_cw});
  auto const d_slots = to_exec(exec, slots);
  auto const count = to_exec(exec, std::vector<int>{n});
  auto const seen = to_exec(exec, std::vector<ft::visibility>(at(2 * n), ft::visibility{}));
  ft::frustum_params params;
  params.max_x = static_cast<float>(camera.width);
  params.max_y = static_cast<float>(camera.height);
  params.log_scale_factor = ft::log_rounded(1.2f);
  params.levels = 8;
  ft::local_search<std::decay_t<decltype(TestFixture::rig())>> search;
  search.rig = TestFixture::rig();
  search.T_cw = poses.data();
  search.slots = d_slots.data();
  search.slot_count = count.data();
  search.frustum = params;
  search.geometry = frame.geometry;
  search.seen = seen.data();
  ft::find_visible_points(exec, search, frame.map.view(), windows);
  auto const got = from_exec(exec, static_cast<ft::visibility const*>(seen.data()), at(2 * n));
  int in_view = 0;
  int out_of_view = 0;
  for (int i = 0; i < 2 * n; ++i) {
    if (want[at(i)] == expected::doubtful) { continue; }
    bool const should = want[at(i)] == expected::seen;
    vector const p = i < n ? s.in_left[at(i)] : s.in_right[at(i - n)];
    ASSERT_EQ(got[at(i)].level >= 0, should) << p.x << ", " << p.y << ", " << p.z;
    (should ? in_view : out_of_view) += 1;
    if (!should) { continue; }
    auto const pixel = camera.project(p).pixel;
    ASSERT_NEAR(static_cast<double>(got[at(i)].x), pixel.x, 3 * TestFixture::lens::float_pixels);
    ASSERT_NEAR(static_cast<double>(got[at(i)].y), pixel.y, 3 * TestFixture::lens::float_pixels);
  }
  EXPECT_GT(in_view, 200);
  EXPECT_GT(out_of_view, 100);
}

TYPED_TEST_P(camera_in_stages, points_of_the_last_frame_find_their_keypoints) {
  auto const camera = TestFixture::functions();
  auto const s = make_scene(camera, 300, 100, 21);
  auto const frame = this->load(s);
  auto const& exec = this->exec();
  int const n = frame.capacity;
  // The last frame held every point at a left keypoint; this one is not quite where it is expected.
  auto const predicted =
      (turn({1, 0.5, -0.3}, 0.003, {0.003, -0.002, 0.003}) * s.T_cw.template cast<double>())
          .template cast<float>();
  ft::soa<ft::memory_space::host, ft::field::angle, ft::field::octave> const staging(n, 2);
  ft::soa<TestFixture::space, ft::field::angle, ft::field::octave> const last_keypoints(n, 2);
  std::vector<int> last_holder(at(2 * n), -1);
  for (int i = 0; i < 2 * n; ++i) {
    staging.view().angle(i) = 0;
    staging.view().octave(i) = 0;
    if (i < n) { last_holder[at(i)] = i; }
  }
  staging.view().count[0] = n;
  staging.view().count[1] = 0;
  ft::copy(exec, last_keypoints.view(), staging.view());
  auto const holder = to_exec(exec, last_holder);
  ft::last_frame_view last;
  last.keypoints = last_keypoints.view();
  last.cameras = 2;
  last.holder = holder.data();
  ft::search_buffers buffers;
  ft::arena<TestFixture::space> const memory([&](ft::carver& c) {
    carve(c, buffers.windows, 2 * n, 1, 2);
    carve(c, buffers.work, 2 * n, n, 1, 2);
  });
  auto const pose = to_exec(exec, std::vector<ft::pose>{predicted});
  ft::last_search<std::decay_t<decltype(TestFixture::rig())>> search;
  search.rig = TestFixture::rig();
  search.T_cw = pose.data();
  search.last_T_cw = pose.data();
  search.last = last;
  search.geometry = frame.geometry;
  search.params.window_radius = static_cast<float>(std::max(7.0, 0.02 * camera.focal()));
  search.params.max_x = static_cast<float>(camera.width);
  search.params.max_y = static_cast<float>(camera.height);
  ft::search_last_frame(exec, search, frame.view, frame.map.view(), buffers);
  EXPECT_EQ(frame.holders(exec), own_points(s));
  EXPECT_EQ(from_exec(exec, static_cast<int const*>(buffers.work.matches), 1)[0],
            static_cast<int>(s.left.size() + s.right.size()));
}

TYPED_TEST_P(camera_in_stages, a_stereo_pair_gives_its_points_back) {
  auto const camera = TestFixture::functions();
  auto const s = make_scene(camera, 400, 0, 31);
  auto const frame = this->load(s);
  auto const& exec = this->exec();
  int const n = frame.capacity;
  ft::fisheye_matches_view out;
  ft::arena<TestFixture::space> const memory([&](ft::carver& c) { carve(c, out, n, 1); });
  auto const before_overlap = to_exec(exec, std::vector<int>{0, 0});
  ft::fisheye_stereo<std::decay_t<decltype(TestFixture::rig())>> const stereo{
      TestFixture::rig(), frame.geometry, before_overlap.data(), {}};
  ft::match_stereo_fisheye(exec, stereo, frame.keypoints.view(), out);
  auto const partner = from_exec(exec, static_cast<int const*>(out.partner), at(2 * n));
  auto const point = from_exec(exec, static_cast<ft::vec3<float> const*>(out.point), at(n));
  auto const depth = from_exec(exec, static_cast<float const*>(out.depth), at(n));
  int found = 0;
  for (int i = 0; i < n; ++i) {
    auto const r =
        std::find_if(s.right.begin(), s.right.end(), [&](mark const& m) { return m.point == i; });
    double const cosine = std::cos(parallax(s, i));
    vector const p = s.in_left[at(i)];
    bool const ahead = s.in_right[at(i)].z > 0.05 * length(p);
    if (r != s.right.end() &&
        (std::abs(cosine - static_cast<double>(stereo.params.max_cosine)) < 1e-5 || !ahead)) {
      continue;  // at a limit of the stage
    }
    bool const should =
        r != s.right.end() && cosine < static_cast<double>(stereo.params.max_cosine);
    ASSERT_EQ(partner[at(i)], should ? n + static_cast<int>(r - s.right.begin()) : -1)
        << p.x << ", " << p.y << ", " << p.z;
    if (!should) { continue; }
    ++found;
    // What pixels rounded to float leave, at this distance and parallax.
    double const tolerance = 10 * TestFixture::lens::float_pixels / camera.focal() * length(p) /
                             std::sin(parallax(s, i));
    auto const& got = point[at(i)];
    ASSERT_LT(length(vector{got.x, got.y, got.z} - p), tolerance)
        << got.x << ", " << got.y << ", " << got.z << " instead of " << p.x << ", " << p.y << ", "
        << p.z;
    ASSERT_EQ(depth[at(i)], got.z);
  }
  EXPECT_GT(found, 100);
}

TYPED_TEST_P(camera_in_stages, pose_optimization_finds_the_pose) {
  auto const camera = TestFixture::functions();
  auto s = make_scene(camera, 250, 0, 41);
  auto const holders = own_points(s);
  auto kept = holders;
  for (std::size_t i = 0; i < s.left.size(); i += 10) {  // keypoints of something else
    s.left[i].pixel.x += i % 20 == 0 ? 40 : -40;
    kept[i] = -1;
  }
  auto const frame = this->load(s, holders);
  auto const& exec = this->exec();
  ft::observations_view observations;
  ft::arena<TestFixture::space> const memory(
      [&](ft::carver& c) { carve(c, observations, 2 * frame.capacity, 1); });
  auto const start =
      (turn({0.4, -1, 0.3}, 0.04, {0.05, -0.04, 0.06}) * s.T_cw.template cast<double>())
          .template cast<float>();
  auto const pose = to_exec(exec, std::vector<ft::pose>{start});
  ft::optimize_frame_poses(exec, TestFixture::rig(), {frame.view, frame.map.view(), frame.geometry},
                           {pose.data(), pose.data(), observations});
  auto const found = from_exec(exec, static_cast<ft::pose const*>(pose.data()), 1)[0];
  EXPECT_LT(difference(found, s.T_cw), 1e-4);
  EXPECT_EQ(frame.holders(exec), kept) << "the false keypoints are let go, and no others";
}

TYPED_TEST_P(camera_in_stages, a_tracker_follows_the_camera) {
  using data = typename TestFixture::lens;
  auto const& exec = this->exec();
  auto const camera = TestFixture::functions();
  auto const& frames = TestFixture::frames();
  ft::tracker_params params;
  params.orb.width = data::width;
  params.orb.height = data::height;
  params.orb.features = 800;
  params.map_slots = params.local_points = params.updates = 4000;
  ft::frame_tracker<typename TestFixture::exec_type, typename TestFixture::rig_type> tracker(
      exec, TestFixture::rig(), params);
  ASSERT_LE(tracker.capacity(), params.map_slots);
  auto const set_images = [&](int f) {
    tracker.set_image(0, 0, {frames.left[f].data(), data::width, data::height, data::width});
    tracker.set_image(0, 1, {frames.right[f].data(), data::width, data::height, data::width});
  };
  set_images(0);
  // The pose that the keypoints of the first frame hold for.
  tracker.set_last(exec, 0, frames.T_cw[0], std::vector<int>(at(2 * tracker.capacity()), -1));
  tracker.extract(exec);
  exec.wait();
  auto const first = this->take(tracker);
  check_depths(camera, first, frames.T_cw[0]);
  if (this->HasFatalFailure()) { return; }
  auto const points = map_of(first, frames.T_cw[0], tracker.geometry());
  tracker.update_map(exec, 0, points.data(), static_cast<int>(points.size()));
  exec.wait();
  std::vector<int> holders(at(2 * tracker.capacity()), -1);
  std::vector<int> local_slots;
  for (auto const& point : points) {
    holders[at(point.slot)] = point.slot;
    int const partner = first.partner[at(point.slot)];
    if (partner >= 0) { holders[at(partner)] = point.slot; }
    local_slots.push_back(point.slot);
  }
  tracker.set_last(exec, 0, frames.T_cw[0], holders);
  set_images(1);
  tracker.track_motion(exec, frames.T_cw[0]);
  exec.wait();
  check_pose(camera, this->take(tracker), frames.T_cw[1]);
  tracker.track_local(exec, local_slots);
  exec.wait();
  check_pose(camera, this->take(tracker), frames.T_cw[1]);
}

REGISTER_TYPED_TEST_SUITE_P(camera_in_stages, points_are_visible_where_they_project_into_the_image,
                            points_of_the_last_frame_find_their_keypoints,
                            a_stereo_pair_gives_its_points_back, pose_optimization_finds_the_pose,
                            a_tracker_follows_the_camera);

}  // namespace FT_ABI
}  // namespace camera_contract

/// Runs the contract's tests on a described model. @param name prefix of the tests' names
/// @param lens the description, by its full name; at global scope, once per name
#if defined(__CUDACC__)
#define FT_CAMERA_CONTRACT(name, lens)                                                    \
  namespace camera_contract {                                                             \
  inline namespace FT_ABI {                                                               \
  INSTANTIATE_TYPED_TEST_SUITE_P(name, camera_model, settings<lens>, executor_name);      \
  INSTANTIATE_TYPED_TEST_SUITE_P(name, camera_in_stages, settings<lens>, executor_name);  \
  INSTANTIATE_TYPED_TEST_SUITE_P(name, camera_on_gpu, gpu_settings<lens>, executor_name); \
  }                                                                                       \
  }                                                                                       \
  static_assert(true, "")
#else
#define FT_CAMERA_CONTRACT(name, lens)                                                   \
  namespace camera_contract {                                                            \
  inline namespace FT_ABI {                                                              \
  INSTANTIATE_TYPED_TEST_SUITE_P(name, camera_model, settings<lens>, executor_name);     \
  INSTANTIATE_TYPED_TEST_SUITE_P(name, camera_in_stages, settings<lens>, executor_name); \
  }                                                                                      \
  }                                                                                      \
  static_assert(true, "")
#endif
