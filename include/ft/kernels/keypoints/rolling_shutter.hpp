// SPDX-License-Identifier: Apache-2.0
/// @file Stages: keypoints of rolling shutters, moved to where a global one would see them.
///
/// Rows are read one after the other, at even distances; the time of a frame is that of the middle
/// of its image. Source: Hedborg, Forssen, Felsberg and Ringaby, "Rolling shutter bundle
/// adjustment", CVPR 2012; here the motion is known beforehand, so that keypoints are moved once
/// and all that follows is that of a global shutter.
#pragma once

#include <cstddef>

#include "ft/cameras/camera_model.hpp"
#include "ft/cameras/monocular_rig.hpp"
#include "ft/cameras/multi_rig.hpp"
#include "ft/cameras/pinhole.hpp"
#include "ft/containers/frame.hpp"
#include "ft/containers/image_pyramid.hpp"
#include "ft/containers/keypoints.hpp"
#include "ft/containers/map_points.hpp"
#include "ft/core/arithmetic.hpp"
#include "ft/core/config.hpp"
#include "ft/core/execution.hpp"
#include "ft/kernels/images/undistort.hpp"
#include "ft/kernels/keypoints/body_velocity.hpp"
#include "ft/math/se3.hpp"
#include "ft/types/poses.hpp"

namespace ft {
inline namespace FT_ABI {

/// When the rows of images are read, where the images are those of the sensor.
/// @tparam Cameras of the rig
template <int Cameras>
struct sensor_rows {
  float readout_s[Cameras] = {};  ///< from the first row to the last one, s
  int height = 0;                 ///< of the images, pixels

  /// Seconds from the middle of the image to a row.
  FT_HOST_DEVICE strict_float time(int camera, float /*x*/, float y) const {
    strict_float const last = static_cast<float>(height > 1 ? height - 1 : 1);
    strict_float const row = min_of(max_of(strict_float(y), strict_float(0)), last);
    return (row / last - 0.5f) * readout_s[camera];
  }
};

/// The same, where images were rectified: the sensor's row is that of the camera which took them.
template <typename Camera>
struct rectified_rows {
  Camera camera{};                 ///< whose sensor is read
  pinhole<float> target{};         ///< of the rectified images
  mat3<double> R_camera_target{};  ///< rotates points of `target` into `camera`
  sensor_rows<1> rows;

  /// Of a pixel without a row: 0.
  FT_HOST_DEVICE strict_float time(int, float x, float y) const {
    mat3<strict_double> R;
    for (int i = 0; i < 9; ++i) { R.m[i] = R_camera_target.m[i]; }
    auto const p = detail::transfer_pixel(
        target.cast<strict_double>(), R, camera.template cast<strict_double>(),
        {strict_double(static_cast<double>(x)), strict_double(static_cast<double>(y))});
    if (!p.valid) { return strict_float(0); }
    return rows.time(0, 0, static_cast<float>(p.pixel.y.value));
  }
};

/// Depths of keypoints that have none of their own: those of the map points that they hold.
struct held_depths {
  map_points_view map;                         ///< [batch]
  first_poses seen_from{nullptr, nullptr, 0};  ///< T_cw null: such depths are not used
};

/// Frames whose rows were read one after the other.
/// @tparam Rig of the keypoints @tparam Rows sensor_rows or rectified_rows
template <typename Rig, typename Rows>
struct rolling_frames {
  Rig rig{};
  Rows rows;
  pyramid_geometry geometry;
  frame_view frame;  ///< keypoints of `rig`'s cameras, and their partners
  pixels_view raw;   ///< the same ones where the images that `rows` are about have them
  shutter_motion const* motion = nullptr;  ///< [batch]
  pixels_view moved;                       ///< output: positions; the counts are not written
  /// In and out. [batch][cameras * capacity] as in stereo_matches_view; of a stereo_rig as in
  /// fisheye_matches_view. Null where keypoints have no depth.
  float* depth = nullptr;
  float* right_x = nullptr;      ///< likewise; null without right images
  vec3<float>* point = nullptr;  ///< likewise, of a stereo_rig alone
  held_depths held;
};

namespace detail {

/// A keypoint where the camera sees it, and its depth.
struct rolling_place {
  float x, y;  ///< as keypoints have them
  int octave;
  strict_double z;    ///< metres along the camera's axis; 0 = infinitely far
  bool held = false;  ///< z is that of its map point: before, it was moved as if it were far
};

/// Item: a keypoint number of a frame. Of two partners the left one moves both: depths are its.
template <typename Rig, typename Rows>
struct move_to_middle_row {
  using scratch = no_scratch;
  using real = strict_double;
  using frames = rolling_frames<Rig, Rows>;

  template <typename Group>
  FT_HOST_DEVICE void operator()(Group, scratch&, int item, frames const& in) const {
    frame_view const& frame = in.frame;
    int const b = item / frame.numbers();
    int const number = item % frame.numbers();
    if (number % frame.capacity() >= count(in, b, number)) { return; }
    int const other = partner(in, b, number);
    if (other >= 0 && !is_left(in, number, other)) { return; }
    vec3<real> const seen = move(in, b, number, true, {real(0), real(0), real(0)});
    if (other >= 0) { move(in, b, other, false, seen); }
  }

private:
  FT_HOST_DEVICE static int count(frames const& in, int b, int number) {
    return *in.frame.camera(b, number / in.frame.capacity()).count;
  }
  /// Number of the keypoint that sees the same in another camera; -1 = none.
  FT_HOST_DEVICE static int partner(frames const& in, int b, int number) {
    if (in.frame.partner == nullptr) { return -1; }
    int const* const of = in.frame.partner + static_cast<std::ptrdiff_t>(b) * in.frame.numbers();
    int const other = of[number];
    return other >= 0 && of[other] == number ? other : -1;
  }
  /// Of two partners.
  FT_HOST_DEVICE static bool is_left([[maybe_unused]] frames const& in, int number, int other) {
    if constexpr (is_mixed_v<Rig>) {
      return in.rig.of[number / in.frame.capacity()].left != other / in.frame.capacity();
    } else {
      return number < other;
    }
  }
  FT_HOST_DEVICE static bool differ(vec3<double> const& a, vec3<double> const& b) {
    return a.x != b.x || a.y != b.y || a.z != b.z;
  }
  /// The motion in a time.
  FT_HOST_DEVICE static rigid<real> moved_by(body_velocity const& v, real t) {
    real const d[6] = {t * real(v.w.x), t * real(v.w.y), t * real(v.w.z),
                       t * real(v.u.x), t * real(v.u.y), t * real(v.u.z)};
    return exp_se3(d);
  }

  // What rigs have in common. The body of a stereo_rig is its left camera.

  template <typename Use>
  FT_HOST_DEVICE static auto with_camera(Rig const& rig, [[maybe_unused]] int c, Use const& use) {
    if constexpr (Rig::rectified) {
      return use(rig.pair(c).camera.template cast<real>());
    } else {
      return c == 0 ? use(rig.left.template cast<real>()) : use(rig.right.template cast<real>());
    }
  }
  FT_HOST_DEVICE static vec3<real> to_body(Rig const& rig, int c, vec3<real> const& p) {
    if constexpr (Rig::rectified) {
      return rig.to_body(c, p);
    } else {
      return c == 0 ? p : rig.T_rl.template cast<real>().inverse() * p;
    }
  }
  FT_HOST_DEVICE static vec3<real> to_camera(Rig const& rig, int c, vec3<real> const& p) {
    if constexpr (Rig::rectified) {
      return rig.to_camera(c, p);
    } else {
      return c == 0 ? p : rig.T_rl.template cast<real>() * p;
    }
  }
  /// A direction likewise. @param turn of the body, between both
  FT_HOST_DEVICE static vec3<real> turned(Rig const& rig, int c, mat3<real> const& turn,
                                          vec3<real> const& ray) {
    vec3<real> const zero{real(0), real(0), real(0)};
    vec3<real> const in_body = turn * (to_body(rig, c, ray) - to_body(rig, c, zero));
    return to_camera(rig, c, in_body) - to_camera(rig, c, zero);
  }

  /// Seconds from the middle of the image to the row of a keypoint.
  FT_HOST_DEVICE static real time_of(frames const& in, int image, int c, int i, int octave) {
    pixels_view const raw = in.raw.slice(image);
    strict_float const t =
        in.rows.time(c, in.geometry.column(raw.x(i), octave), in.geometry.row(raw.y(i), octave));
    return static_cast<double>(t.value);
  }
  FT_HOST_DEVICE static real depth_of(frames const& in, int b, int number, int octave) {
    if constexpr (!Rig::rectified) {
      int const capacity = in.frame.capacity();
      if (in.point == nullptr || number >= capacity) { return real(0); }
      return static_cast<double>(in.point[static_cast<std::ptrdiff_t>(b) * capacity + number].z);
    } else {
      if (in.depth == nullptr) { return real(0); }
      float const z = in.depth[static_cast<std::ptrdiff_t>(b) * in.frame.numbers() + number];
      return z > 0 ? static_cast<double>(in.geometry.depth(z, octave)) : 0.0;
    }
  }

  /// Of the map point that a keypoint holds, metres; 0 = it holds none, or is not asked for.
  FT_HOST_DEVICE static real held_depth(frames const& in, int b, int number) {
    first_poses const& from = in.held.seen_from;
    if (from.T_cw == nullptr || from.inliers[b] < from.min_inliers) { return real(0); }
    int const slot = in.frame.holder[static_cast<std::ptrdiff_t>(b) * in.frame.numbers() + number];
    if (slot < 0) { return real(0); }
    vec3<real> const in_world = in.held.map.slice(b).position(slot).template cast<real>();
    vec3<real> const in_body = from.T_cw[b].template cast<real>() * in_world;
    real const z = to_camera(in.rig, number / in.frame.capacity(), in_body).z;
    return z > real(0) ? z : real(0);
  }

  /// Writes where a keypoint is seen at the middle row's time, and its depth.
  /// @param own whether its depth is its own; otherwise that of `body`, a point in the body's frame
  ///   or 0
  /// @return the point in the body's frame at the time of its row; 0 without a depth of its own
  FT_HOST_DEVICE static vec3<real> move(frames const& in, int b, int number, bool own,
                                        vec3<real> const& body) {
    vec3<real> const nothing{real(0), real(0), real(0)};
    int const c = number / in.frame.capacity();
    int const i = number % in.frame.capacity();
    int const image = in.frame.image(b, c);
    keypoints_view const kp = in.frame.keypoints.slice(image);
    pixels_view const moved = in.moved.slice(image);
    rolling_place at{kp.x(i), kp.y(i), kp.octave(i), real(0)};
    moved.x(i) = at.x;
    moved.y(i) = at.y;
    shutter_motion const& v = in.motion[b];
    if (own) {
      at.z = depth_of(in, b, number, at.octave);
    } else if (dot(body, body) > real(0)) {
      at.z = to_camera(in.rig, c, body).z;
    }
    if (!(at.z > real(0))) {
      at.z = held_depth(in, b, number);
      at.held = at.z > real(0);
    }
    bool const same = !differ(v.before.w, v.now.w) && !differ(v.before.u, v.now.u);
    if (same && !(at.held && differ(v.now.u, {0, 0, 0}))) { return nothing; }
    real const t = time_of(in, image, c, i, at.octave);
    // The body at the row's time to that at the middle row's.
    rigid<real> T = moved_by(v.now, -t);
    rigid<real> const back = moved_by(v.before, t);
    if (!at.held) { T = T * back; }
    return with_camera(in.rig, c, [&](auto const& camera) {
      pyramid_geometry const& g = in.geometry;
      auto seen = camera.unproject({real(static_cast<double>(g.column(at.x, at.octave))),
                                    real(static_cast<double>(g.row(at.y, at.octave)))});
      if (at.held) { seen.direction = turned(in.rig, c, back.R, seen.direction); }
      bool const near = at.z > real(0) && seen.direction.z > real(0);
      vec3<real> const point =
          near ? to_body(in.rig, c, scaled(seen.direction, at.z / seen.direction.z)) : nothing;
      vec3<real> const now =
          near ? to_camera(in.rig, c, T * point) : turned(in.rig, c, T.R, seen.direction);
      auto const p = camera.project(now);
      auto const x = static_cast<float>(p.pixel.x.value);
      auto const y = static_cast<float>(p.pixel.y.value);
      bool const good = seen.valid && p.valid && scalar::is_finite(x) && scalar::is_finite(y) &&
                        !(near && !(now.z > real(0)));
      if (!good) { return nothing; }
      moved.x(i) = g.level_column(x, at.octave);
      moved.y(i) = g.level_row(y, at.octave);
      if (near && own && !at.held) { write_depth(in, b, number, at.octave, {p.pixel.x, now, T}); }
      return at.held ? nothing : point;  // a partner has a map point of its own
    });
  }

  /// A keypoint at the middle row's time.
  struct moved_point {
    real x;          ///< column, pixels
    vec3<real> now;  ///< in the camera's frame
    rigid<real> T;   ///< what moved it, in the body's frame
  };
  FT_HOST_DEVICE static void write_depth(frames const& in, int b, int number, int octave,
                                         moved_point const& to) {
    if constexpr (!Rig::rectified) {
      std::ptrdiff_t const k = static_cast<std::ptrdiff_t>(b) * in.frame.capacity() + number;
      in.point[k] = (to.T * in.point[k].template cast<real>()).template cast<float>();
      in.depth[k] = in.point[k].z;
    } else {
      std::ptrdiff_t const k = static_cast<std::ptrdiff_t>(b) * in.frame.numbers() + number;
      in.depth[k] = in.geometry.level_depth(static_cast<float>(to.now.z.value), octave);
      if (in.right_x == nullptr || !(in.right_x[k] >= 0)) { return; }
      int const c = number / in.frame.capacity();
      real const bf = static_cast<double>(in.rig.pair(c).bf());
      real const right = to.x - bf / to.now.z;
      // One that leaves the image keeps its depth.
      in.right_x[k] = right < real(0)
                          ? -1.0f
                          : in.geometry.level_column(static_cast<float>(right.value), octave);
    }
  }
};

}  // namespace detail

/// Moves keypoints to where the camera would see the same points at the time of the image's middle,
/// with their depths and right columns; those without a depth as if they were infinitely far, or as
/// far as the map point that they hold. Those that have been moved before are moved by the
/// difference; `frame` has them then. Where nothing moves, positions are copied. Computed in double
/// and rounded to float once. Two partners are taken to have seen their point at one time: where
/// their rows, or read-outs, differ, its depth errs by what the camera moved in between.
/// Asynchronous on `exec`; allocates nothing; one launch.
template <typename Exec, typename Rig, typename Rows>
void move_to_middle_rows(Exec const& exec, rolling_frames<Rig, Rows> const& in) {
  for_each_item<per_thread>(exec, in.frame.batch * in.frame.numbers(),
                            detail::move_to_middle_row<Rig, Rows>{}, in);
}

}  // namespace FT_ABI
}  // namespace ft
