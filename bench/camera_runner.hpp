// SPDX-License-Identifier: Apache-2.0
/// @file The camera runner, instantiated once per executor: each model's functions over arrays of
/// points.
#pragma once

#include <cmath>
#include <cstddef>
#include <cstdint>
#include <memory>
#include <stdexcept>
#include <string>
#include <type_traits>
#include <utility>
#include <vector>

#include "bench/clock.hpp"
#include "bench/owned_executor.hpp"
#include "bench/runner.hpp"
#include "ft/cameras/double_sphere.hpp"
#include "ft/cameras/field_of_view.hpp"
#include "ft/cameras/kannala_brandt.hpp"
#include "ft/cameras/pinhole.hpp"
#include "ft/cameras/radtan.hpp"
#include "ft/cameras/unified.hpp"
#include "ft/core/execution.hpp"
#include "ft/core/memory.hpp"

namespace bench {
inline namespace FT_ABI {

/// One set of points: three columns of camera coordinates and two of pixels; results.
struct point_columns {
  float const* in[5];  ///< x, y, z, u, v
  float* out[6];       ///< pixel, Jacobian or ray
  unsigned char* valid;
};

template <typename Camera>
struct project_points {
  using scratch = ft::no_scratch;
  template <typename Group>
  FT_HOST_DEVICE void operator()(Group, scratch&, int i, Camera const& camera,
                                 point_columns const& p) const {
    auto const r = camera.project({p.in[0][i], p.in[1][i], p.in[2][i]});
    p.out[0][i] = ft::to_plain(r.pixel.x);
    p.out[1][i] = ft::to_plain(r.pixel.y);
    p.valid[i] = static_cast<unsigned char>(r.valid);
  }
};

template <typename Camera>
struct differentiate_points {
  using scratch = ft::no_scratch;
  template <typename Group>
  FT_HOST_DEVICE void operator()(Group, scratch&, int i, Camera const& camera,
                                 point_columns const& p) const {
    auto const J = camera.project_with_jacobian({p.in[0][i], p.in[1][i], p.in[2][i]}).jacobian;
    bool finite = true;
    FT_UNROLL
    for (int k = 0; k < 6; ++k) {
      p.out[k][i] = ft::to_plain(J.m[k]);
      finite = finite && ft::scalar::is_finite(J.m[k]);
    }
    p.valid[i] = static_cast<unsigned char>(finite);
  }
};

template <typename Camera>
struct unproject_points {
  using scratch = ft::no_scratch;
  template <typename Group>
  FT_HOST_DEVICE void operator()(Group, scratch&, int i, Camera const& camera,
                                 point_columns const& p) const {
    auto const r = camera.unproject({p.in[3][i], p.in[4][i]});
    p.out[0][i] = ft::to_plain(r.direction.x);
    p.out[1][i] = ft::to_plain(r.direction.y);
    p.out[2][i] = ft::to_plain(r.direction.z);
    p.valid[i] = static_cast<unsigned char>(r.valid);
  }
};

/// Only the memory traffic of project_points.
struct copy_points {
  using scratch = ft::no_scratch;
  template <typename Group>
  FT_HOST_DEVICE void operator()(Group, scratch&, int i, point_columns const& p) const {
    p.out[0][i] = p.in[0][i] + p.in[2][i];
    p.out[1][i] = p.in[1][i];
    p.valid[i] = 1;
  }
};

/// Calibrations of real cameras, and the sizes of their images.
template <template <typename> class Model>
struct lens;
template <>
struct lens<ft::pinhole> {
  static constexpr int width = 752, height = 480;
  static ft::pinhole<double> camera() { return {435.0, 435.0, 367.2, 252.2}; }
};
template <>
struct lens<ft::kannala_brandt> {  // TUM-VI, like the double sphere and the extended unified
  static constexpr int width = 512, height = 512;
  static ft::kannala_brandt<double> camera() {
    return {190.978, 190.973, 254.932, 256.897, 0.003482, 0.000715, -0.002053, 0.000203};
  }
};
template <>
struct lens<ft::radtan4> {  // EuRoC
  static constexpr int width = 752, height = 480;
  static ft::radtan4<double> camera() {
    return {
        458.654, 457.296, 367.215, 248.375, {-0.28340811, 0.07395907, 0.00019359, 1.76187114e-05}};
  }
};
template <>
struct lens<ft::radtan5> {  // TUM RGB-D
  static constexpr int width = 640, height = 480;
  static ft::radtan5<double> camera() {
    return {517.306408,
            516.469215,
            318.643040,
            255.313989,
            {0.262383, -0.953104, -0.005358, 0.002628, 1.163314}};
  }
};
template <>
struct lens<ft::radtan8> {  // a depth camera's
  static constexpr int width = 640, height = 576;
  static ft::radtan8<double> camera() {
    return {504.7, 504.8, 325.9, 336.2, {5.16, 3.29, -2e-5, 3e-5, 0.165, 5.49, 5.02, 0.87}};
  }
};
template <>
struct lens<ft::double_sphere> {
  static constexpr int width = 512, height = 512;
  static ft::double_sphere<double> camera() {
    return {158.286, 158.274, 254.961, 256.889, -0.172131, 0.593118};
  }
};
template <>
struct lens<ft::extended_unified> {
  static constexpr int width = 512, height = 512;
  static ft::extended_unified<double> camera() {
    return {191.148, 191.137, 254.961, 256.889, 0.632, 1.046};
  }
};
template <>
struct lens<ft::unified> {
  static constexpr int width = 640, height = 480;
  static ft::unified<double> camera() {
    return {430.2, 429.8, 321.3, 238.9, 1.2, {-0.03, 0.01, 0.0004, -0.0003}};
  }
};
template <>
struct lens<ft::field_of_view> {
  static constexpr int width = 640, height = 512;
  static ft::field_of_view<double> camera() { return {223.6, 223.4, 316.1, 255.9, 0.9335}; }
};

/// Uniform in [0, 1): the same for the same arguments.
inline double uniform(std::uint64_t point, std::uint64_t draw) {
  std::uint64_t v = point * 0x9e3779b97f4a7c15u + draw * 0xd1b54a32d192ed03u;
  v = (v ^ (v >> 30)) * 0xbf58476d1ce4e5b9u;
  v = (v ^ (v >> 27)) * 0x94d049bb133111ebu;
  v ^= v >> 31;
  return static_cast<double>(v >> 11) * 0x1p-53;
}

/// `count` points that the camera sees, at 0.5 to 20 m: pixels uniform over the image, drawn again
/// if they have no ray.
/// @param columns [5][count]
template <template <typename> class Model>
void draw_points(std::size_t count, float* columns) {
  auto const exact = lens<Model>::camera();
  auto const camera = exact.template cast<float>();
  std::vector<unsigned char> failed(count, 0);
  ft::host_exec().parallel_for(static_cast<int>(count), [&](int number) {
    auto const i = static_cast<std::size_t>(number);
    for (std::uint64_t attempt = 0; attempt < 100; ++attempt) {
      float const u = static_cast<float>(lens<Model>::width * uniform(i, 3 * attempt));
      float const v = static_cast<float>(lens<Model>::height * uniform(i, 3 * attempt + 1));
      double const depth = 0.5 * std::pow(40.0, uniform(i, 3 * attempt + 2));
      auto const ray = exact.unproject({static_cast<double>(u), static_cast<double>(v)});
      if (!ray.valid || !camera.unproject({u, v}).valid) { continue; }
      auto const d = ray.direction;
      double const scale = depth / std::sqrt(d.x * d.x + d.y * d.y + d.z * d.z);
      ft::vec3<float> const P{static_cast<float>(d.x * scale), static_cast<float>(d.y * scale),
                              static_cast<float>(d.z * scale)};
      if (!camera.project(P).valid) { continue; }
      float const values[5] = {P.x, P.y, P.z, u, v};
      for (std::size_t c = 0; c < 5; ++c) { columns[c * count + i] = values[c]; }
      return;
    }
    failed[i] = 1;
  });
  for (unsigned char f : failed) {
    if (f != 0) { throw std::runtime_error("a camera of the bench sees nothing"); }
  }
}

/// Time of the work enqueued between the two calls, microseconds.
template <typename Exec>
class interval;
template <>
class interval<ft::host_exec> {
public:
  void begin(ft::host_exec const&) { start_ = now_us(); }
  double end(ft::host_exec const&) { return now_us() - start_; }

private:
  double start_ = 0;
};
#if defined(__CUDACC__)
template <>
class interval<ft::cuda_exec> {
public:
  void begin(ft::cuda_exec const& exec) { begin_.record(exec.stream); }
  double end(ft::cuda_exec const& exec) {
    float ms = 0;
    end_.record(exec.stream);
    ft::throw_on_error(cudaEventSynchronize(end_.get()), "cudaEventSynchronize");
    ft::throw_on_error(cudaEventElapsedTime(&ms, begin_.get(), end_.get()), "cudaEventElapsedTime");
    return 1000.0 * static_cast<double>(ms);
  }

private:
  ft::event begin_{cudaEventDefault};
  ft::event end_{cudaEventDefault};
};
#endif

template <typename Exec>
class camera_runner_of final : public camera_runner {
public:
  camera_runner_of(int host_threads, int points, int sets)
      : owned_(host_threads),
        points_(points),
        sets_(sets),
        host_in_(5 * all()),
        in_(5 * all()),
        out_(6 * all()),
        valid_(all()) {
    add<ft::pinhole>();
    add<ft::kannala_brandt>();
    add<ft::radtan4>();
    add<ft::radtan5>();
    add<ft::radtan8>();
    add<ft::double_sphere>();
    add<ft::extended_unified>();
    add<ft::unified>();
    add<ft::field_of_view>();
    cases_.push_back({"(copy)", "float", "project"});
    steps_.push_back({&draw_points<ft::pinhole>, &run_copy});
  }

  std::vector<camera_case> const& cases() const override { return cases_; }
  void select(int number) override {
    selected_ = static_cast<std::size_t>(number);
    auto const draw = steps_[selected_].draw;
    if (draw != drawn_) {
      // A set is a range of all points.
      draw(all(), host_in_.data());
      ft::copy(owned_.exec, in_.data(), static_cast<float const*>(host_in_.data()), 5 * all());
      owned_.exec.wait();
      drawn_ = draw;
    }
  }
  double run(int first, int launches) override {
    time_.begin(owned_.exec);
    for (int i = first; i < first + launches; ++i) {
      last_set_ = i % sets_;
      steps_[selected_].run(owned_.exec, points_, columns(last_set_));
    }
    return time_.end(owned_.exec);
  }
  double valid_share() override {
    std::vector<unsigned char> valid(static_cast<std::size_t>(points_));
    ft::copy(owned_.exec, valid.data(), static_cast<unsigned char const*>(columns(last_set_).valid),
             valid.size());
    owned_.exec.wait();
    std::size_t count = 0;
    for (unsigned char v : valid) { count += v; }
    return static_cast<double>(count) / static_cast<double>(valid.size());
  }

private:
  using draw_function = void (*)(std::size_t, float*);
  using run_function = void (*)(Exec const&, int, point_columns const&);
  struct step {
    draw_function draw;
    run_function run;
  };

  std::size_t all() const {
    return static_cast<std::size_t>(points_) * static_cast<std::size_t>(sets_);
  }
  point_columns columns(int set) const {
    std::size_t const offset = static_cast<std::size_t>(set) * static_cast<std::size_t>(points_);
    point_columns p;
    for (std::size_t c = 0; c < 5; ++c) { p.in[c] = in_.data() + c * all() + offset; }
    for (std::size_t c = 0; c < 6; ++c) { p.out[c] = out_.data() + c * all() + offset; }
    p.valid = valid_.data() + offset;
    return p;
  }

  template <template <typename> class Model, typename Scalar, template <typename> class Op>
  static void run_model(Exec const& exec, int points, point_columns const& p) {
    auto const camera = lens<Model>::camera().template cast<Scalar>();
    ft::for_each_item<ft::per_thread>(exec, points, Op<Model<Scalar>>{}, camera, p);
  }
  static void run_copy(Exec const& exec, int points, point_columns const& p) {
    ft::for_each_item<ft::per_thread>(exec, points, copy_points{}, p);
  }
  template <template <typename> class Model, typename Scalar>
  void add_scalar(char const* scalar) {
    std::string const model = Model<Scalar>::name;
    cases_.push_back({model, scalar, "project"});
    steps_.push_back({&draw_points<Model>, &run_model<Model, Scalar, project_points>});
    cases_.push_back({model, scalar, "project_with_jacobian"});
    steps_.push_back({&draw_points<Model>, &run_model<Model, Scalar, differentiate_points>});
    cases_.push_back({model, scalar, "unproject"});
    steps_.push_back({&draw_points<Model>, &run_model<Model, Scalar, unproject_points>});
  }
  template <template <typename> class Model>
  void add() {
    add_scalar<Model, float>("float");
    add_scalar<Model, ft::strict_float>("strict_float");
  }

  owned_executor<Exec> owned_;
  int points_;
  int sets_;
  ft::buffer<float, ft::staging_space<Exec>> host_in_;
  ft::buffer<float, Exec::space> in_;
  ft::buffer<float, Exec::space> out_;
  ft::buffer<unsigned char, Exec::space> valid_;
  interval<Exec> time_;
  std::vector<camera_case> cases_;
  std::vector<step> steps_;
  std::size_t selected_ = 0;
  int last_set_ = 0;
  draw_function drawn_ = nullptr;
};

}  // namespace FT_ABI

std::unique_ptr<camera_runner> make_host_cameras(int threads, int points, int sets);
std::unique_ptr<camera_runner> make_cuda_cameras(int points, int sets);

}  // namespace bench
