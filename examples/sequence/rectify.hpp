// SPDX-License-Identifier: Apache-2.0
/// @file Turns a calibrated pair of raw cameras into a rectified pair: rotations, maps, remap.
#pragma once

#include <Eigen/Core>
#include <cstdint>
#include <string>
#include <vector>

#include "examples/sequence/types.hpp"

namespace seq {

struct projected_pixel {
  Eigen::Vector2d pixel = Eigen::Vector2d::Zero();
  bool valid = false;  ///< in front of the lens and where the distortion is one-to-one
};

/// Maps camera-frame points (metres, any scale) to pixels, (0, 0) = centre of the first pixel.
///
/// - pinhole: u = fx x/z + cx, z > 0
/// - radial-tangential: OpenCV's model, z > 0, up to the radius where it folds back
/// - Kannala-Brandt: r = theta (1 + k1 theta^2 + .. + k4 theta^8), up to the angle where it folds
/// back
/// - double sphere, unified, extended unified: as ft's models of these names, z <= 0 too
class lens_projection {
public:
  explicit lens_projection(camera_intrinsics const& camera);
  projected_pixel operator()(Eigen::Vector3d const& point) const;
  /// Direction of a pixel as (x/z, y/z), by Newton's method. Invalid outside the domain, if the
  /// iteration does not converge to 1e-9, or for directions 84 degrees and more off the axis.
  projected_pixel unproject(Eigen::Vector2d const& pixel) const;

private:
  Eigen::Vector2d radial_tangential(Eigen::Vector2d const& p) const;
  /// The inverse. @return false if the iteration does not converge, or beyond the limit
  bool undistorted(Eigen::Vector2d const& target, Eigen::Vector2d& out) const;
  // Of the models with a sphere. @return false outside their domains
  bool on_sphere(Eigen::Vector3d const& point, Eigen::Vector2d& out) const;
  bool from_sphere(Eigen::Vector2d const& m, Eigen::Vector3d& ray) const;

  lens model_;
  double fx_, fy_, cx_, cy_;
  double shape_[2] = {};  ///< the parameters of a sphere
  double k_[8] = {};      ///< the rest of camera_intrinsics::distortion, zero where absent
  double limit_ = 0;      ///< largest radius (radial-tangential) or angle (Kannala-Brandt)
};

/// Pixels per radian on the axis, as a share of fx and fy.
double scale_on_axis(camera_intrinsics const& camera);

namespace detail {
constexpr double pi = 3.14159265358979323846;
constexpr double max_tangent = 9.5;  ///< 84 degrees off the axis
}  // namespace detail

/// Source pixel of every pixel; -1, -1 for none.
struct pixel_map {
  int width = 0;
  int height = 0;
  std::vector<float> x;  ///< row-major
  std::vector<float> y;
};

/// A pixel map in fixed point: bilinear weights in 1/32 of a pixel.
class remap_table {
public:
  remap_table() = default;
  /// @param source_width,source_height size of the images to be mapped, at least 2 each
  /// @throws seq::error on sizes below 2 or a map whose arrays differ from its size
  remap_table(pixel_map const& map, int source_width, int source_height);

  /// Bilinear; 0 where the map points more than half a pixel outside the source. Allocates the
  /// result.
  /// @throws seq::error if the source has another size
  image apply(image const& source) const;
  /// Share of pixels with a source, 0..1.
  double valid_fraction() const { return valid_fraction_; }

private:
  struct entry {
    std::int32_t offset;   ///< of the upper left source pixel; -1 = none
    std::uint16_t fx, fy;  ///< weight of the right and of the lower neighbour, 0..32
  };
  int width_ = 0;
  int height_ = 0;
  int source_width_ = 0;
  int source_height_ = 0;
  double valid_fraction_ = 0;
  std::vector<entry> entries_;
};

/// The rectification of a raw pair: each camera is rotated by half of their relative rotation, then
/// both so that x is along the baseline (Bouguet). Both get one focal length and principal point,
/// chosen so that every pixel has a source in both cameras. Exception: the focal length is at least
/// 0.75 of the raw ones, so wide lenses lose their margins. The image size is kept.
class rectifier {
public:
  /// @param raw checked rig (see check_rig)
  /// @throws seq::error if the pair cannot be rectified in rows: the right camera is not to the
  ///   right (the baseline is more than 45 degrees off x), or the cameras diverge by more than 60
  ///   degrees
  explicit rectifier(stereo_rig const& raw);

  /// Two equal pinholes; T_body_left is that of the rectified left camera.
  stereo_rig const& rig() const { return rig_; }
  /// Rotates points of the raw left camera into the rectified left camera.
  Eigen::Matrix3d const& left_rotation() const { return left_rotation_; }
  Eigen::Matrix3d const& right_rotation() const { return right_rotation_; }
  pixel_map const& left_map() const { return left_map_; }
  pixel_map const& right_map() const { return right_map_; }

  /// @throws seq::error if `raw` does not have the rig's size
  image left(image const& raw) const { return left_table_.apply(raw); }
  image right(image const& raw) const { return right_table_.apply(raw); }
  /// Share of rectified pixels with a source, the smaller of both cameras, 0..1.
  double valid_fraction() const;

private:
  stereo_rig rig_;
  Eigen::Matrix3d left_rotation_;
  Eigen::Matrix3d right_rotation_;
  pixel_map left_map_;
  pixel_map right_map_;
  remap_table left_table_;
  remap_table right_table_;
};

}  // namespace seq
