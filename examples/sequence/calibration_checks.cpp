// SPDX-License-Identifier: Apache-2.0
#include "examples/sequence/detail/calibration_checks.hpp"

#include <Eigen/LU>
#include <Eigen/SVD>
#include <algorithm>
#include <array>
#include <cmath>

#include "examples/sequence/calibration.hpp"
#include "examples/sequence/detail/text.hpp"

namespace seq {
namespace detail {
namespace {

std::string describe(limits const& range) {
  return "must be " + std::string(range.above_low ? "above " : "at least ") + to_text(range.low) +
         " and at most " + to_text(range.high);
}

bool all_zero(std::vector<double> const& values) {
  return std::all_of(values.begin(), values.end(), [](double k) { return k == 0; });
}

}  // namespace

void check_number(double value, limits const& range, std::string const& path,
                  std::string const& key, std::string const& text) {
  std::string const where = path + ": " + key + " = " + text + ": ";
  if (!std::isfinite(value)) { throw error(where + "must be finite"); }
  bool const low_enough = range.above_low ? value > range.low : value >= range.low;
  if (!low_enough || value > range.high) { throw error(where + describe(range)); }
}

void check_number(double value, limits const& range, std::string const& path,
                  std::string const& key) {
  check_number(value, range, path, key, to_text(value));
}

Eigen::Matrix3d checked_rotation(Eigen::Matrix3d const& m, std::string const& path,
                                 std::string const& key) {
  double const residual = (m * m.transpose() - Eigen::Matrix3d::Identity()).cwiseAbs().maxCoeff();
  double const determinant = m.determinant();
  if (!(residual <= 1e-3) || !(determinant > 0)) {
    throw error(path + ": " + key + ": not a rotation: determinant " + to_text(determinant) +
                ", |R R^T - I| = " + to_text(residual) + ", at most 0.001 allowed");
  }
  if (residual <= 1e-12) {
    return m;  // keeps an exact identity exact
  }
  Eigen::JacobiSVD<Eigen::Matrix3d, Eigen::NoQRPreconditioner> const svd(
      m, Eigen::ComputeFullU | Eigen::ComputeFullV);
  return svd.matrixU() * svd.matrixV().transpose();
}

Eigen::Isometry3d checked_transform(std::vector<double> const& m, std::string const& path,
                                    std::string const& key) {
  if (m.size() == 16) {
    std::array<double, 4> const last{0, 0, 0, 1};
    for (std::size_t i = 0; i < 4; ++i) {
      if (!(std::fabs(m[12 + i] - last[i]) <= 1e-6)) {
        throw error(path + ": " + key + ": last row holds " + to_text(m[12 + i]) +
                    ", must be 0 0 0 1");
      }
    }
  }
  Eigen::Map<Eigen::Matrix<double, 3, 4, Eigen::RowMajor> const> const rows(m.data());
  Eigen::Isometry3d result = Eigen::Isometry3d::Identity();
  result.linear() = checked_rotation(rows.leftCols<3>(), path, key);
  result.translation() = rows.col(3);
  return result;
}

void drop_zero_distortion(camera_intrinsics& camera) {
  if (camera.model == lens::radial_tangential && all_zero(camera.distortion)) {
    camera.model = lens::pinhole;
    camera.distortion.clear();
  }
}

void set_one_camera(stereo_rig& rig, camera_kind kind) {
  rig.right = rig.left;
  rig.T_left_right = Eigen::Isometry3d::Identity();
  if (kind == camera_kind::rgbd) { rig.T_left_right.translation().x() = usual_virtual_baseline; }
}

void check_camera(camera_intrinsics const& camera, std::string const& name,
                  std::string const& source) {
  auto const check = [&](char const* key, double value, limits const& range) {
    check_number(value, range, source, name + ": " + key);
  };
  check("width", camera.width, side_limits);
  check("height", camera.height, side_limits);
  check("fx", camera.fx, focal_limits);
  check("fy", camera.fy, focal_limits);
  check("cx", camera.cx, {-1.0 * camera.width, 2.0 * camera.width});
  check("cy", camera.cy, {-1.0 * camera.height, 2.0 * camera.height});
  for (double const k : camera.distortion) {
    check("distortion coefficient", k, coefficient_limits);
  }
  std::size_t const n = camera.distortion.size();
  bool const radial = camera.model == lens::radial_tangential;
  bool const fov = camera.model == lens::field_of_view;
  std::size_t const wanted = camera.model == lens::pinhole          ? 0
                             : fov                                  ? 1
                             : camera.model == lens::kannala_brandt ? 4
                             : camera.model == lens::unified        ? 5
                                                                    : 2;
  if (radial ? n != 4 && n != 5 && n != 8 : n != wanted) {
    std::string const allowed = radial        ? "4, 5 or 8"
                                : wanted == 0 ? "none"
                                              : std::to_string(wanted);
    throw error(source + ": " + name + ": " + std::to_string(n) +
                " distortion coefficients, must have " + allowed);
  }
  if (fov) { check("omega", camera.distortion[0], {1e-3, 3.14}); }
  for (int i = 0; i < shape_parameters(camera.model); ++i) {
    bool const two = camera.model == lens::double_sphere;
    double const value = camera.distortion[static_cast<std::size_t>(i)];
    if (camera.model == lens::unified) {
      check("xi", value, {0, 1000});
    } else if (two && i == 0) {
      check("xi", value, {-1, 1, true});
    } else if (two || i == 0) {
      check("alpha", value, {0, 1});
    } else {
      check("beta", value, {1e-6, 1e6});
    }
  }
}

}  // namespace detail

bool stereo_rig::rectified() const {
  auto const ideal = [](camera_intrinsics const& camera) {
    return camera.model == lens::pinhole ||
           (camera.model == lens::radial_tangential && detail::all_zero(camera.distortion));
  };
  constexpr double pixel_tolerance = 1e-3;
  // 1e-5 rad is a few thousandths of a pixel; text files round to 6 digits and more.
  constexpr double angle_tolerance = 1e-5;
  bool const same = left.width == right.width && left.height == right.height &&
                    std::fabs(left.fx - right.fx) <= pixel_tolerance &&
                    std::fabs(left.fy - right.fy) <= pixel_tolerance &&
                    std::fabs(left.cx - right.cx) <= pixel_tolerance &&
                    std::fabs(left.cy - right.cy) <= pixel_tolerance;
  Eigen::Vector3d const t = T_left_right.translation();
  double const turn = (T_left_right.linear() - Eigen::Matrix3d::Identity()).cwiseAbs().maxCoeff();
  return ideal(left) && ideal(right) && same && turn <= angle_tolerance && t.x() > 0 &&
         std::fabs(t.y()) <= angle_tolerance * t.x() && std::fabs(t.z()) <= angle_tolerance * t.x();
}

void check_rig(stereo_rig const& rig, std::string const& source, camera_kind kind) {
  using namespace detail;
  bool const pair = is_pair(kind);
  check_camera(rig.left, pair ? "left camera" : "camera", source);
  if (pair) { check_camera(rig.right, "right camera", source); }
  if (rig.left.width != rig.right.width || rig.left.height != rig.right.height) {
    throw error(source + ": left camera is " + std::to_string(rig.left.width) + " x " +
                std::to_string(rig.left.height) + ", right camera " +
                std::to_string(rig.right.width) + " x " + std::to_string(rig.right.height) +
                ": must be equal");
  }
  if (kind == camera_kind::stereo && std::fabs(rig.left.readout_s - rig.right.readout_s) > 1e-5) {
    throw error(source + ": rows of the left camera are read in " + to_text(rig.left.readout_s) +
                " s, those of the right one in " + to_text(rig.right.readout_s) +
                " s: must be equal");
  }
  if (!rig.T_left_right.matrix().allFinite() || !rig.T_body_left.matrix().allFinite()) {
    throw error(source + ": camera extrinsics are not finite");
  }
  checked_rotation(rig.T_left_right.linear(), source, "T_left_right");
  checked_rotation(rig.T_body_left.linear(), source, "T_body_left");
  if (kind != camera_kind::mono) {
    check_number(rig.baseline(), {min_baseline, max_baseline}, source, "baseline",
                 to_text(rig.baseline()) + " m");
  }
  check_number(rig.fps, fps_limits, source, "frames per second");
}

}  // namespace seq
