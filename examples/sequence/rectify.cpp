// SPDX-License-Identifier: Apache-2.0
#include "examples/sequence/rectify.hpp"

#include <Eigen/Geometry>
#include <Eigen/LU>
#include <algorithm>
#include <cmath>
#include <string>

namespace seq {
namespace {

constexpr double min_focal_factor = 0.75;  // of the raw focal lengths

using detail::max_tangent;
using detail::pi;

/// Rectangle of directions (x/z, y/z).
struct field {
  double left = -max_tangent, right = max_tangent, top = -max_tangent, bottom = max_tangent;
};

/// Direction in the rectified frame of a raw pixel. The pixel moves towards the principal point
/// until it has a direction.
/// @return false if none is found, or if it is 84 degrees and more off the axis
bool rectified_direction(lens_projection const& lens, Eigen::Vector2d const& centre,
                         Eigen::Vector2d const& pixel, Eigen::Matrix3d const& rotation,
                         Eigen::Vector2d& direction) {
  for (double share = 1; share > 0.3; share -= 0.01) {
    projected_pixel const ray = lens.unproject(centre + share * (pixel - centre));
    if (!ray.valid) { continue; }
    Eigen::Vector3d const turned = rotation * ray.pixel.homogeneous();
    if (turned.z() > 0 && turned.head<2>().cwiseAbs().maxCoeff() < max_tangent * turned.z()) {
      direction = turned.hnormalized();
      return true;
    }
  }
  return false;
}

/// Shrinks `inner` to directions that the camera sees: no border pixel's direction is inside.
void shrink_to_view(camera_intrinsics const& camera, Eigen::Matrix3d const& rotation,
                    field& inner) {
  constexpr int samples = 64;  // per side
  lens_projection const lens(camera);
  Eigen::Vector2d const centre(camera.cx, camera.cy);
  double const w = camera.width - 1;
  double const h = camera.height - 1;
  Eigen::Vector2d d;
  for (int i = 0; i <= samples; ++i) {
    double const s = static_cast<double>(i) / samples;
    if (rectified_direction(lens, centre, {0, s * h}, rotation, d)) {
      inner.left = std::max(inner.left, d.x());
    }
    if (rectified_direction(lens, centre, {w, s * h}, rotation, d)) {
      inner.right = std::min(inner.right, d.x());
    }
    if (rectified_direction(lens, centre, {s * w, 0}, rotation, d)) {
      inner.top = std::max(inner.top, d.y());
    }
    if (rectified_direction(lens, centre, {s * w, h}, rotation, d)) {
      inner.bottom = std::min(inner.bottom, d.y());
    }
  }
}

/// Principal point nearest to `wanted` with which pixels 0..last see only directions low..high.
double principal_point(double wanted, double focal, double last, double low, double high) {
  double const smallest = last - focal * high;
  double const largest = -focal * low;
  if (smallest > largest) {
    return 0.5 * (smallest + largest);  // the field is too narrow: rounding, or no such field
  }
  return std::clamp(wanted, smallest, largest);
}

// How many rows of the source a rectified row is, in the mean over the middle column: rows of
// rolling shutters are read as those of the source. Where the principal point moves up or down,
// times are off by as much in all rows, and beside the middle column by the lens: 0.6 ms in the
// mean of rows in 33 ms with lenses as EuRoC's, 2.6 ms in the corners.
double rows_per_row(pixel_map const& map) {
  int first = -1;
  int last = -1;
  auto const row_of = [&](int v) {
    return map.y[static_cast<std::size_t>(v) * static_cast<std::size_t>(map.width) +
                 static_cast<std::size_t>(map.width / 2)];
  };
  for (int v = 0; v < map.height; ++v) {
    if (row_of(v) < 0) { continue; }
    if (first < 0) { first = v; }
    last = v;
  }
  if (last <= first) { return 1; }
  return std::max(0.0, static_cast<double>(row_of(last) - row_of(first)) / (last - first));
}

pixel_map make_map(camera_intrinsics const& raw, Eigen::Matrix3d const& rotation,
                   camera_intrinsics const& rectified) {
  pixel_map map;
  map.width = rectified.width;
  map.height = rectified.height;
  std::size_t const n = static_cast<std::size_t>(map.width) * static_cast<std::size_t>(map.height);
  map.x.assign(n, -1.0F);
  map.y.assign(n, -1.0F);
  lens_projection const project(raw);
  Eigen::Matrix3d const back = rotation.transpose();
  std::size_t i = 0;
  for (int v = 0; v < map.height; ++v) {
    for (int u = 0; u < map.width; ++u, ++i) {
      Eigen::Vector3d const ray((u - rectified.cx) / rectified.fx,
                                (v - rectified.cy) / rectified.fy, 1.0);
      projected_pixel const p = project(back * ray);
      bool const inside = p.valid && p.pixel.x() > -0.5 && p.pixel.y() > -0.5 &&
                          p.pixel.x() < raw.width - 0.5 && p.pixel.y() < raw.height - 0.5;
      if (inside) {
        map.x[i] = static_cast<float>(p.pixel.x());
        map.y[i] = static_cast<float>(p.pixel.y());
      }
    }
  }
  return map;
}

}  // namespace

remap_table::remap_table(pixel_map const& map, int source_width, int source_height)
    : width_(map.width),
      height_(map.height),
      source_width_(source_width),
      source_height_(source_height) {
  if (source_width < 2 || source_height < 2) {
    throw error("remap: source images of " + std::to_string(source_width) + " x " +
                std::to_string(source_height) + " pixels, must be at least 2 x 2");
  }
  std::size_t const n = static_cast<std::size_t>(std::max(width_, 0)) *
                        static_cast<std::size_t>(std::max(height_, 0));
  if (map.x.size() != n || map.y.size() != n) {
    throw error("remap: map arrays of " + std::to_string(map.x.size()) + " and " +
                std::to_string(map.y.size()) + " values, must have " + std::to_string(n));
  }
  entries_.resize(n);
  std::size_t valid = 0;
  for (std::size_t i = 0; i < n; ++i) {
    float const x = map.x[i];
    float const y = map.y[i];
    bool const inside = x > -0.5F && y > -0.5F && x < static_cast<float>(source_width) - 0.5F &&
                        y < static_cast<float>(source_height) - 0.5F;
    if (!inside) {  // also NaN
      entries_[i] = {-1, 0, 0};
      continue;
    }
    ++valid;
    // Positions up to half a pixel outside take the border's value; the last pixel is "32/32 of the
    // next".
    int const fixed_x =
        std::clamp(static_cast<int>(std::lround(x * 32)), 0, 32 * (source_width - 1));
    int const fixed_y =
        std::clamp(static_cast<int>(std::lround(y * 32)), 0, 32 * (source_height - 1));
    int const base_x = std::min(fixed_x / 32, source_width - 2);
    int const base_y = std::min(fixed_y / 32, source_height - 2);
    entries_[i] = {base_y * source_width + base_x,
                   static_cast<std::uint16_t>(fixed_x - 32 * base_x),
                   static_cast<std::uint16_t>(fixed_y - 32 * base_y)};
  }
  valid_fraction_ = n == 0 ? 0.0 : static_cast<double>(valid) / static_cast<double>(n);
}

image remap_table::apply(image const& source) const {
  bool const same_size = source.width == source_width_ && source.height == source_height_;
  if (!same_size || source.pixels.size() != static_cast<std::size_t>(source_width_) *
                                                static_cast<std::size_t>(source_height_)) {
    throw error("remap: image of " + std::to_string(source.width) + " x " +
                std::to_string(source.height) + " pixels, must be " +
                std::to_string(source_width_) + " x " + std::to_string(source_height_));
  }
  image result;
  result.width = width_;
  result.height = height_;
  result.pixels.resize(entries_.size());
  std::uint8_t const* const pixels = source.pixels.data();
  for (std::size_t i = 0; i < entries_.size(); ++i) {
    entry const e = entries_[i];
    if (e.offset < 0) {
      continue;  // resize() wrote 0
    }
    std::uint8_t const* const top = pixels + e.offset;
    std::uint8_t const* const bottom = top + source_width_;
    int const upper = top[0] * (32 - e.fx) + top[1] * e.fx;
    int const lower = bottom[0] * (32 - e.fx) + bottom[1] * e.fx;
    result.pixels[i] = static_cast<std::uint8_t>((upper * (32 - e.fy) + lower * e.fy + 512) >> 10);
  }
  return result;
}

rectifier::rectifier(stereo_rig const& raw) {
  Eigen::AngleAxisd const turn(raw.T_left_right.linear());
  constexpr double degrees = 180 / pi;
  if (!(std::fabs(turn.angle()) <= 60 / degrees)) {
    throw error("rectification: cameras differ by " + std::to_string(turn.angle() * degrees) +
                " degrees, at most 60 allowed");
  }
  // With x_left = R x_right + t, both are rotated into the frame half-way between.
  Eigen::Matrix3d const halved = Eigen::AngleAxisd(0.5 * turn.angle(), turn.axis()).matrix();
  Eigen::Vector3d const baseline = halved.transpose() * raw.T_left_right.translation();
  double const off_axis =
      std::atan2(baseline.tail<2>().norm(), baseline.x());  // pi if left and right are swapped
  if (!(off_axis <= 45 / degrees)) {
    throw error("rectification: baseline " + std::to_string(off_axis * degrees) +
                " degrees off the x axis, at most 45 allowed (left and right swapped, or one above "
                "the other?)");
  }
  Eigen::Matrix3d const align = shortest_rotation(baseline, Eigen::Vector3d::UnitX());
  left_rotation_ = align * halved.transpose();
  right_rotation_ = align * halved;

  field inner;
  shrink_to_view(raw.left, left_rotation_, inner);
  shrink_to_view(raw.right, right_rotation_, inner);
  double const w = raw.left.width - 1;
  double const h = raw.left.height - 1;
  double const left_scale = scale_on_axis(raw.left);
  double const right_scale = scale_on_axis(raw.right);
  double const raw_focal = 0.25 * (left_scale * raw.left.fx + left_scale * raw.left.fy +
                                   right_scale * raw.right.fx + right_scale * raw.right.fy);
  double focal = min_focal_factor * raw_focal;
  bool const overlap = inner.right > inner.left && inner.bottom > inner.top;
  if (overlap) {
    focal = std::max({focal, w / (inner.right - inner.left), h / (inner.bottom - inner.top)});
  }
  // With a narrow overlap the focal length would become very long: beyond twice the raw one the
  // margins stay empty instead.
  focal = overlap ? std::min(focal, 2 * raw_focal) : raw_focal;
  camera_intrinsics rectified;
  rectified.width = raw.left.width;
  rectified.height = raw.left.height;
  rectified.fx = rectified.fy = focal;
  rectified.cx =
      principal_point(0.5 * (raw.left.cx + raw.right.cx), focal, w, inner.left, inner.right);
  rectified.cy =
      principal_point(0.5 * (raw.left.cy + raw.right.cy), focal, h, inner.top, inner.bottom);

  left_map_ = make_map(raw.left, left_rotation_, rectified);
  right_map_ = make_map(raw.right, right_rotation_, rectified);
  rectified.readout_s = std::min(raw.left.readout_s * rows_per_row(left_map_), 0.1);
  rig_.left = rig_.right = rectified;
  rig_.T_left_right.translation() = Eigen::Vector3d(raw.baseline(), 0, 0);
  rig_.T_body_left = raw.T_body_left * Eigen::Isometry3d(left_rotation_.transpose());
  rig_.fps = raw.fps;
  left_table_ = remap_table(left_map_, raw.left.width, raw.left.height);
  right_table_ = remap_table(right_map_, raw.right.width, raw.right.height);
}

double rectifier::valid_fraction() const {
  return std::min(left_table_.valid_fraction(), right_table_.valid_fraction());
}

}  // namespace seq
