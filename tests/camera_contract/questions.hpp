// SPDX-License-Identifier: Apache-2.0
/// @file A model, asked through an executor. Part of tests/camera_contract.hpp.
#pragma once

#include <gtest/gtest.h>

#include <algorithm>
#include <cmath>
#include <cstring>
#include <functional>
#include <memory>
#include <vector>

#include "ft/cameras/camera_model.hpp"
#include "ft/core/execution.hpp"
#include "ft/core/memory.hpp"
#include "tests/camera_contract/description.hpp"
#include "tests/camera_contract/geometry.hpp"

namespace camera_contract {
inline namespace FT_ABI {

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

}  // namespace FT_ABI
}  // namespace camera_contract
