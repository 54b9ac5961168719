// SPDX-License-Identifier: Apache-2.0
#include <Eigen/LU>
#include <algorithm>
#include <cmath>
#include <cstddef>
#include <limits>

#include "examples/sequence/rectify.hpp"

namespace seq {
namespace {

using detail::max_tangent;
using detail::pi;
constexpr double max_radius = 10.0;  // of radial-tangential distortion, as x/z

/// theta (1 + k1 theta^2 + k2 theta^4 + k3 theta^6 + k4 theta^8)
double fisheye_radius(double const* k, double theta) {
  double const t2 = theta * theta;
  return theta * (1 + t2 * (k[0] + t2 * (k[1] + t2 * (k[2] + t2 * k[3]))));
}

/// Radial factor of OpenCV's model at the squared radius `r2`; k[2] and k[3] are p1 and p2.
double radial_factor(double const* k, double r2) {
  double const numerator = 1 + r2 * (k[0] + r2 * (k[1] + r2 * k[4]));
  double const denominator = 1 + r2 * (k[5] + r2 * (k[6] + r2 * k[7]));
  return numerator / denominator;
}

/// The first argument at which `f` stops growing, on (0, end].
template <typename F>
double growth_limit(F const& f, double end) {
  constexpr int steps = 2000;
  double previous = 0;
  for (int i = 1; i <= steps; ++i) {
    double const value = f(end * i / steps);
    if (!(value > previous)) { return end * (i - 1) / steps; }
    previous = value;
  }
  return end;
}

/// How far behind the plane through its centre a sphere's points are seen, in radii: the limit of
/// the domain of a projection from a centre shifted by `shift` radii.
double reach(double shift) { return shift <= 1 ? shift : 1 / shift; }

}  // namespace

lens_projection::lens_projection(camera_intrinsics const& camera)
    : model_(camera.model), fx_(camera.fx), fy_(camera.fy), cx_(camera.cx), cy_(camera.cy) {
  auto first = camera.distortion.begin();
  for (int i = 0; i < shape_parameters(model_); ++i) { shape_[i] = *first++; }
  auto const n = std::min<std::ptrdiff_t>(camera.distortion.end() - first, 8);
  std::copy_n(first, n, k_);
  switch (model_) {
    case lens::pinhole:
    case lens::double_sphere:
    case lens::extended_unified:
    case lens::field_of_view:
      break;
    case lens::unified:
    case lens::radial_tangential: {
      // What is on a sphere is at any distance from the axis; only a distortion can fold.
      bool const straight = std::all_of(k_, k_ + 8, [](double k) { return k == 0; });
      limit_ =
          model_ == lens::unified && straight
              ? std::numeric_limits<double>::infinity()
              : growth_limit([&](double r) { return r * radial_factor(k_, r * r); }, max_radius);
      break;
    }
    case lens::kannala_brandt:
      limit_ = growth_limit([&](double t) { return fisheye_radius(k_, t); }, pi);
      break;
  }
}

Eigen::Vector2d lens_projection::radial_tangential(Eigen::Vector2d const& p) const {
  double const x = p.x();
  double const y = p.y();
  double const r2 = x * x + y * y;
  double const radial = radial_factor(k_, r2);
  double const p1 = k_[2];
  double const p2 = k_[3];
  return {x * radial + 2 * p1 * x * y + p2 * (r2 + 2 * x * x),
          y * radial + p1 * (r2 + 2 * y * y) + 2 * p2 * x * y};
}

bool lens_projection::undistorted(Eigen::Vector2d const& target, Eigen::Vector2d& out) const {
  Eigen::Vector2d p = target;
  double residual = 1;
  for (int i = 0; i < 30 && residual > 1e-12; ++i) {
    Eigen::Vector2d const miss = radial_tangential(p) - target;
    residual = miss.norm();
    constexpr double h = 1e-6;
    Eigen::Matrix2d jacobian;
    for (int axis = 0; axis < 2; ++axis) {
      Eigen::Vector2d const step = h * Eigen::Vector2d::Unit(axis);
      jacobian.col(axis) = (radial_tangential(p + step) - radial_tangential(p - step)) / (2 * h);
    }
    double const determinant = jacobian.determinant();
    if (!(std::fabs(determinant) > 1e-9)) { return false; }
    p -= jacobian.inverse() * miss;
  }
  if (!(residual <= 1e-9) || !(p.norm() <= limit_)) { return false; }
  out = p;
  return true;
}

bool lens_projection::on_sphere(Eigen::Vector3d const& point, Eigen::Vector2d& out) const {
  double const r2 = point.head<2>().squaredNorm();
  double z = point.z();
  double radius = 0;  // of the sphere (ellipsoid) that the last pinhole looks at
  double depth = 0;
  double shift = shape_[0];  // of that pinhole, in radii
  if (model_ == lens::unified) {
    radius = point.norm();
    depth = z + shift * radius;
  } else {
    bool const two = model_ == lens::double_sphere;
    double const alpha = two ? shape_[1] : shape_[0];
    if (two) { z += shape_[0] * point.norm(); }
    radius = std::sqrt((two ? 1 : shape_[1]) * r2 + z * z);
    depth = alpha * radius + (1 - alpha) * z;
    shift = alpha < 1 ? alpha / (1 - alpha) : std::numeric_limits<double>::infinity();
  }
  if (!(z > -reach(shift) * radius) || !(depth > 0)) { return false; }  // also NaN
  out = point.head<2>() / depth;
  return true;
}

bool lens_projection::from_sphere(Eigen::Vector2d const& m, Eigen::Vector3d& ray) const {
  double const r2 = m.squaredNorm();
  if (model_ == lens::unified) {
    double const xi = shape_[0];
    double const rest = 1 + (1 - xi * xi) * r2;
    if (!(rest > 0)) { return false; }
    double const length = (xi + std::sqrt(rest)) / (1 + r2);
    ray << length * m, length - xi;
    return true;
  }
  bool const two = model_ == lens::double_sphere;
  double const alpha = two ? shape_[1] : shape_[0];
  double const bent = (two ? 1 : shape_[1]) * r2;
  double const rest = 1 - (2 * alpha - 1) * bent;
  if (!(rest > 0)) { return false; }
  double const z = (1 - alpha * alpha * bent) / (alpha * std::sqrt(rest) + 1 - alpha);
  if (!two) {
    ray << m, z;
    return true;
  }
  double const xi = shape_[0];
  double const length = (z * xi + std::sqrt(z * z + (1 - xi * xi) * r2)) / (z * z + r2);
  ray << length * m, length * z - xi;
  return true;
}

projected_pixel lens_projection::operator()(Eigen::Vector3d const& point) const {
  projected_pixel result;
  Eigen::Vector2d distorted = Eigen::Vector2d::Zero();
  switch (model_) {
    case lens::pinhole:
    case lens::radial_tangential: {
      if (!(point.z() > 0)) {  // also NaN
        return result;
      }
      distorted = point.head<2>() / point.z();
      if (model_ == lens::radial_tangential) {
        if (!(distorted.norm() <= limit_)) { return result; }
        distorted = radial_tangential(distorted);
      }
      break;
    }
    case lens::kannala_brandt: {
      double const rho = point.head<2>().norm();
      double const theta = std::atan2(rho, point.z());
      if (!(theta <= limit_)) { return result; }
      if (rho > 0) { distorted = point.head<2>() * (fisheye_radius(k_, theta) / rho); }
      break;
    }
    case lens::field_of_view: {  // as ft::field_of_view
      if (!(point.z() > 0)) { return result; }
      double const rho = point.head<2>().norm();
      double const omega = k_[0];
      double const radius = std::atan2(2 * rho * std::tan(0.5 * omega), point.z()) / omega;
      if (rho > 0) { distorted = point.head<2>() * (radius / rho); }
      break;
    }
    case lens::double_sphere:
    case lens::unified:
    case lens::extended_unified: {
      if (!on_sphere(point, distorted)) { return result; }
      if (model_ == lens::unified) {
        if (!(distorted.norm() <= limit_)) { return result; }
        distorted = radial_tangential(distorted);
      }
      break;
    }
  }
  result.pixel = {fx_ * distorted.x() + cx_, fy_ * distorted.y() + cy_};
  result.valid = result.pixel.allFinite();
  return result;
}

projected_pixel lens_projection::unproject(Eigen::Vector2d const& pixel) const {
  Eigen::Vector2d const target((pixel.x() - cx_) / fx_, (pixel.y() - cy_) / fy_);
  projected_pixel result;
  switch (model_) {
    case lens::pinhole:
      result.pixel = target;
      break;
    case lens::radial_tangential: {
      if (!undistorted(target, result.pixel)) { return result; }
      break;
    }
    case lens::kannala_brandt: {
      double const radius = target.norm();
      double low = 0;
      double high = limit_;
      if (!(radius <= fisheye_radius(k_, limit_))) { return result; }
      for (int i = 0; i < 60; ++i) {  // monotonic up to the limit
        double const middle = 0.5 * (low + high);
        (fisheye_radius(k_, middle) < radius ? low : high) = middle;
      }
      if (!(low < 0.5 * pi) || !(std::tan(low) < max_tangent)) { return result; }
      result.pixel = radius > 0 ? Eigen::Vector2d(target * (std::tan(low) / radius)) : target;
      break;
    }
    case lens::field_of_view: {
      double const radius = target.norm();
      double const angle = k_[0] * radius;
      if (!(angle < 0.5 * pi)) { return result; }
      double const slope = 2 * std::tan(0.5 * k_[0]);
      double const factor = radius > 0 ? std::tan(angle) / (slope * radius) : k_[0] / slope;
      result.pixel = target * factor;
      break;
    }
    case lens::double_sphere:
    case lens::unified:
    case lens::extended_unified: {
      Eigen::Vector2d m = target;
      Eigen::Vector3d ray;
      if (model_ == lens::unified && !undistorted(target, m)) { return result; }
      if (!from_sphere(m, ray) || !(ray.z() > 0)) { return result; }
      result.pixel = ray.hnormalized();
      break;
    }
  }
  result.valid = result.pixel.allFinite() && result.pixel.norm() < max_tangent;
  return result;
}

double scale_on_axis(camera_intrinsics const& camera) {
  if (camera.model == lens::field_of_view) {
    return 2 * std::tan(0.5 * camera.distortion[0]) / camera.distortion[0];
  }
  bool const shifted = camera.model == lens::double_sphere || camera.model == lens::unified;
  return shifted ? 1 / (1 + camera.distortion[0]) : 1;
}

}  // namespace seq
