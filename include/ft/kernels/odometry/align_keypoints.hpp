// SPDX-License-Identifier: Apache-2.0
/// @file Stages: what images look like around map points, and keypoints moved to where the image
/// looks like that again.
///
/// A corner is found up to a pixel of its level off from one image to the next. So a keypoint that
/// was matched to a map point is moved until the pixels around it are those of the keyframe that
/// held the point first, warped by both poses. Source: Baker and Matthews, "Lucas-Kanade 20 years
/// on", 2004, the inverse compositional algorithm, with a mean of its own for each image.
///
/// Sums are of integers, so they have the same bits in any order.
#pragma once

#include <cstddef>
#include <cstdint>

#include "ft/containers/frame.hpp"
#include "ft/containers/image_pyramid.hpp"
#include "ft/containers/map_points.hpp"
#include "ft/containers/point_patches.hpp"
#include "ft/core/arithmetic.hpp"
#include "ft/core/config.hpp"
#include "ft/core/execution.hpp"
#include "ft/core/group.hpp"
#include "ft/kernels/images/undistort.hpp"
#include "ft/kernels/map/keyframe_input.hpp"
#include "ft/kernels/odometry/state.hpp"
#include "ft/kernels/pose/detail/reprojection.hpp"
#include "ft/types/images.hpp"
#include "ft/types/poses.hpp"

namespace ft {
inline namespace FT_ABI {

/// Frames, the map points that their keypoints hold, and their images.
template <typename Rig>
struct frames_to_align {
  Rig rig;
  frame_view frame;
  image_pyramid_view images;
  map_points_view map;
  int const* numbers;  ///< [batch][slots] of points, as in point_records_view
  point_patches_view patches;
  pose const* T_cw;  ///< [batch] near the frame's
  /// [batch] may be null; cameras whose plan is `nothing` are passed over
  camera_track const* tracks;
  pixels_view aligned;  ///< output, of all keypoints, in the shape of the frame's
  float* right_x;  ///< output, that of the frame, moved with the keypoints; null if the frame's is
  /// output, [batch][numbers] squared ways of the keypoints to their patches' places, pixels of
  /// their levels; -1: there is none
  float* moves;
};

namespace detail {

/// Where a map point is seen, in pixels of the input image, and how that changes.
template <typename Rig>
struct seen_point {
  using real = strict_float;
  real u, v;
  mat3<real> by_world;  ///< d (u, v) / d point in the world, its first two rows
  bool valid;

  FT_HOST_DEVICE seen_point(Rig const& rig, int camera, rigid<real> const& T_cw,
                            vec3<float> const& point) {
    observation o{};
    o.point = point;
    o.right_u = -1.0f;
    o.camera = camera;
    reprojection<Rig, real, true> const r(rig, T_cw, o);
    u = -r.error[0];
    v = -r.error[1];
    mat3<real> const by_body = r.derivative(rig, o);
    by_world = by_body * T_cw.R;
    valid = r.valid && r.in_camera.z > real(0) && scalar::is_finite(u) && scalar::is_finite(v);
  }
  FT_HOST_DEVICE vec3<real> row(int k) const {
    return {by_world.m[3 * k], by_world.m[3 * k + 1], by_world.m[3 * k + 2]};
  }
};

/// Item: a keypoint number of a batch entry. Says where its point is.
template <typename Rig>
struct align_keypoint {
  using real = strict_float;
  static constexpr int side = point_patch::side - 2;  ///< compared: all have neighbours
  static constexpr int pixels = side * side;
  static constexpr int most_steps = 12;
  static constexpr float small_step = 1.0f / 64;  ///< pixels of the level
  static constexpr float farthest = 6.0f;         ///< likewise; a corner's own patch, 7 pixels wide
  static constexpr int fraction = 8;              ///< bits of a place between pixels
  static constexpr int one = 1 << fraction;
  static constexpr int kept_bits = 4;  ///< below a grey value

  struct scratch {
    std::int16_t grey[pixels], across[pixels], down[pixels];
  };
  /// A patch's gradients, each twice as large.
  struct slopes {
    std::int64_t xx, xy, yy;  ///< about their means, times `pixels`
    int x, y;
  };
  struct place {
    real x, y;
  };
  /// Pixels of the level of the frame for those of the patch: columns (a, c) and (b, d).
  struct warp {
    real a, b, c, d;
  };

  template <typename Group>
  FT_HOST_DEVICE void operator()(Group g, scratch& s, int item,
                                 frames_to_align<Rig> const& in) const {
    frame_view const& frame = in.frame;
    int const b = item / frame.numbers();
    int const number = item % frame.numbers();
    int const c = number / frame.capacity();
    int const i = number % frame.capacity();
    keypoints_view const keypoints = frame.camera(b, c);
    if (i >= *keypoints.count) { return; }
    if (g.rank() == 0) { write(in, item, {real(keypoints.x(i)), real(keypoints.y(i))}, real(-1)); }
    if (in.tracks != nullptr && in.tracks[b].plan == search_plan::nothing) { return; }
    int const slot = frame.holder[item];
    if (slot < 0) { return; }
    std::ptrdiff_t const at = in.patches.at(b, slot);
    if (in.patches.number[at] == 0 || in.patches.number[at] != in.numbers[at]) { return; }
    point_patch const& patch = in.patches.patch[at];
    int const octave = keypoints.octave(i);
    pyramid_geometry const& geometry = in.images.geometry;
    warp w;
    if (!find_warp(in, b, c, slot, geometry.inv_scale[octave], patch, w)) { return; }
    slopes const of = prepare(g, s, patch);
    if (!is_corner(of)) { return; }
    real const scale = geometry.scale[octave];
    place const start{real(keypoints.x(i)) * geometry.inv_scale[octave],
                      real(keypoints.y(i)) * geometry.inv_scale[octave]};
    place moved = start;
    if (!descend(g, s, in.images.level(frame.image(b, c), octave), patch, w, of, moved)) { return; }
    g.sync();
    if (g.rank() != 0) { return; }
    real const x = moved.x - start.x, y = moved.y - start.y;
    write(in, item, {real(keypoints.x(i)) + x * scale, real(keypoints.y(i)) + y * scale},
          x * x + y * y);
  }

private:
  /// The keypoint's position, and the squared way to it.
  FT_HOST_DEVICE static void write(frames_to_align<Rig> const& in, int item, place at, real move) {
    frame_view const& frame = in.frame;
    int const b = item / frame.numbers(), number = item % frame.numbers();
    int const c = number / frame.capacity(), i = number % frame.capacity();
    in.moves[item] = move.value;
    if (in.right_x != nullptr) {
      float const right = frame.right_x[item];
      real const moved = real(right) + (at.x - real(frame.camera(b, c).x(i)));
      in.right_x[item] = right < 0 ? right : max_of(moved.value, 0.0f);
    }
    pixels_view const aligned = in.aligned.slice(frame.image(b, c));
    aligned.x(i) = at.x.value;
    aligned.y(i) = at.y.value;
  }
  FT_HOST_DEVICE static bool find_warp(frames_to_align<Rig> const& in, int b, int c, int slot,
                                       float inv_scale, point_patch const& patch, warp& w) {
    seen_point<Rig> const seen(in.rig, c, in.T_cw[b].template cast<real>(),
                               in.map.slice(b).position(slot));
    vec3<real> const across = patch.across.template cast<real>();
    vec3<real> const down = patch.down.template cast<real>();
    w.a = dot(seen.row(0), across) * inv_scale;
    w.b = dot(seen.row(0), down) * inv_scale;
    w.c = dot(seen.row(1), across) * inv_scale;
    w.d = dot(seen.row(1), down) * inv_scale;
    // Twice as large or half as large, about an octave of keypoints: more is another patch.
    real const area = w.a * w.d - w.b * w.c;
    return seen.valid && area > real(0.25f) && area < real(4.0f);
  }

  /// Fills the scratch. Its sums are for all threads.
  template <typename Group>
  FT_HOST_DEVICE static slopes prepare(Group g, scratch& s, point_patch const& patch) {
    four_sums first{}, second{};
    for (int i = g.rank(); i < pixels; i += g.size()) {
      std::uint8_t const* const p = patch.grey + (i / side + 1) * point_patch::side + i % side + 1;
      int const x = p[1] - p[-1];
      int const y = p[point_patch::side] - p[-point_patch::side];
      s.grey[i] = static_cast<std::int16_t>(*p << kept_bits);
      s.across[i] = static_cast<std::int16_t>(x);
      s.down[i] = static_cast<std::int16_t>(y);
      first = first + four_sums{{x, y, x * x, x * y}};
      second.of[0] += y * y;
    }
    g.sync();
    first = g.reduce(first, sum_op{});
    second = g.reduce(second, sum_op{});
    std::int64_t const x = first.of[0], y = first.of[1];
    return {pixels * std::int64_t{first.of[2]} - x * x, pixels * std::int64_t{first.of[3]} - x * y,
            pixels * std::int64_t{second.of[0]} - y * y, first.of[0], first.of[1]};
  }

  /// Whether both axes of the slopes are known: the shorter one is a 64th of the longer one at
  /// least.
  FT_HOST_DEVICE static bool is_corner(slopes const& of) {
    std::int64_t const sum = of.xx + of.yy;
    real const area = real(static_cast<float>(of.xx)) * static_cast<float>(of.yy) -
                      real(static_cast<float>(of.xy)) * static_cast<float>(of.xy);
    return sum > 0 && real(66.0f) * area > real(static_cast<float>(sum)) * static_cast<float>(sum);
  }

  /// @param[in,out] at the keypoint, pixels of the level
  /// @return whether it ends where the images are more alike than where it began
  template <typename Group>
  FT_HOST_DEVICE static bool descend(Group g, scratch const& s, gray_view level,
                                     point_patch const& patch, warp const& w, slopes const& of,
                                     place& at) {
    place const start = at;
    real const xx = static_cast<float>(of.xx), xy = static_cast<float>(of.xy),
               yy = static_cast<float>(of.yy);
    // Slopes are twice as large, differences 2^kept_bits times.
    real const unit = real(2.0f / (1 << kept_bits)) / (xx * yy - xy * xy);
    std::int64_t before = 0;
    FT_NO_UNROLL
    for (int step = 0; step <= most_steps; ++step) {
      if (!is_inside(level, patch, w, at)) { return false; }
      four_sums const n = compare(g, s, level, patch, w, at);
      std::int64_t const mean = n.of[2];
      std::int64_t const unlike = pixels * std::int64_t{n.of[3]} - mean * mean;
      if (step == 0) { before = unlike; }
      auto const x = static_cast<float>(pixels * std::int64_t{n.of[0]} - of.x * mean);
      auto const y = static_cast<float>(pixels * std::int64_t{n.of[1]} - of.y * mean);
      real const across = (yy * x - xy * y) * unit;
      real const down = (xx * y - xy * x) * unit;
      if (scalar::abs(across) < real(small_step) && scalar::abs(down) < real(small_step)) {
        return unlike <= before;
      }
      at.x = at.x - (w.a * across + w.b * down);
      at.y = at.y - (w.c * across + w.d * down);
      // Written so that a NaN is too far.
      if (!(scalar::abs(at.x - start.x) < real(farthest) &&
            scalar::abs(at.y - start.y) < real(farthest))) {
        return false;
      }
    }
    return false;
  }

  /// Where the patch's pixel (x, y) is in the level.
  FT_HOST_DEVICE static place warped(point_patch const& patch, warp const& w, place at, int x,
                                     int y) {
    real const across = real(static_cast<float>(x - point_patch::before)) - patch.x;
    real const down = real(static_cast<float>(y - point_patch::before)) - patch.y;
    return {at.x + (w.a * across + w.b * down), at.y + (w.c * across + w.d * down)};
  }
  FT_HOST_DEVICE static bool is_inside(gray_view level, point_patch const& patch, warp const& w,
                                       place at) {
    bool inside = true;
    for (int corner = 0; corner < 4; ++corner) {
      place const p = warped(patch, w, at, corner % 2 == 0 ? 1 : side, corner < 2 ? 1 : side);
      inside = inside && p.x >= real(1) && p.x < real(static_cast<float>(level.width - 2)) &&
               p.y >= real(1) && p.y < real(static_cast<float>(level.height - 2));
    }
    return inside;
  }
  /// Sums of differences d: of slopes times d, d, and d^2.
  template <typename Group>
  FT_HOST_DEVICE static four_sums compare(Group g, scratch const& s, gray_view level,
                                          point_patch const& patch, warp const& w, place at) {
    four_sums n{};
    for (int i = g.rank(); i < pixels; i += g.size()) {
      place const p = warped(patch, w, at, i % side + 1, i / side + 1);
      auto const u = static_cast<int>((p.x * real(one) + real(0.5f)).value);
      auto const v = static_cast<int>((p.y * real(one) + real(0.5f)).value);
      int const d = between(level, u, v) - s.grey[i];
      n = n + four_sums{{s.across[i] * d, s.down[i] * d, d, d * d}};
    }
    return g.reduce(n, sum_op{});
  }
  /// Grey value between four pixels, times 2^kept_bits.
  FT_HOST_DEVICE static int between(gray_view level, int u, int v) {
    int const x = u & (one - 1), y = v & (one - 1);
    std::uint8_t const* const above = level.row(v >> fraction) + (u >> fraction);
    std::uint8_t const* const below = above + level.stride;
    int const sum = (one - y) * ((one - x) * above[0] + x * above[1]) +
                    y * ((one - x) * below[0] + x * below[1]);
    return (sum + (1 << (2 * fraction - kept_bits - 1))) >> (2 * fraction - kept_bits);
  }
};

/// Item: a keypoint number of a batch entry. Keeps the patch of a point that has none.
template <typename Rig>
struct keep_patch {
  using scratch = no_scratch;
  using real = strict_float;

  template <typename Group>
  FT_HOST_DEVICE void operator()(Group g, scratch&, int item, keyframe_input<Rig> const& in,
                                 image_pyramid_view const& images, odometry_map_view const& map,
                                 keyframe_workspace const& work,
                                 point_patches_view const& to) const {
    frame_view const& frame = in.frame;
    int const b = item / frame.numbers();
    int const number = item % frame.numbers();
    int const c = number / frame.capacity();
    int const i = number % frame.capacity();
    keypoints_view const keypoints = frame.camera(b, c);
    if (in.order[b] == keyframe_order::none || i >= *keypoints.count) { return; }
    int const slot = frame.holder[item];
    if (slot < 0 || !is_first(work, frame, map, b, c, slot, number)) { return; }
    std::ptrdiff_t const at = map.records.at(b, slot);
    if (to.number[at] == map.records.number[at]) { return; }
    int const octave = keypoints.octave(i);
    gray_view const level = images.level(frame.image(b, c), octave);
    real const x = real(keypoints.x(i)) * images.geometry.inv_scale[octave];
    real const y = real(keypoints.y(i)) * images.geometry.inv_scale[octave];
    int const u = static_cast<int>(x.value), v = static_cast<int>(y.value);
    int const left = u - point_patch::before, top = v - point_patch::before;
    if (!(x >= real(0) && y >= real(0)) || left < 0 || top < 0 ||
        left + point_patch::side > level.width || top + point_patch::side > level.height) {
      return;
    }
    seen_point<Rig> const seen(in.rig, c, in.T_cw[b].template cast<real>(),
                               map.points.slice(b).position(slot));
    point_patch& patch = to.patch[at];
    for (int k = g.rank(); k < point_patch::side * point_patch::side; k += g.size()) {
      patch.grey[k] = level.row(top + k / point_patch::side)[left + k % point_patch::side];
    }
    g.sync();
    if (g.rank() != 0) { return; }
    patch.x = (x - real(static_cast<float>(u))).value;
    patch.y = (y - real(static_cast<float>(v))).value;
    write_axes(seen, images.geometry.scale[octave], patch);
    to.number[at] = seen.valid ? map.records.number[at] : 0;
    keyframes_view const& keyframes = map.keyframes;
    keyframes.aligned[keyframes.at(b, keyframes.position(keyframes.made[b]), number)] = 1;
  }

private:
  /// Whether the keypoint is the first of those that hold the point.
  FT_HOST_DEVICE static bool is_first(keyframe_workspace const& work, frame_view const& frame,
                                      odometry_map_view const& map, int b, int c, int slot,
                                      int number) {
    auto const claim = [&](int camera) {
      return work.claim[work.at(b, camera, slot, frame.cameras, map.records.slots)];
    };
    for (int before = 0; before < c; ++before) {
      if (claim(before) != unclaimed) { return false; }
    }
    return claim(c) == number;
  }
  /// The shortest ways in space that are seen as one pixel: those across the ray.
  FT_HOST_DEVICE static void write_axes(seen_point<Rig> const& seen, float scale,
                                        point_patch& patch) {
    vec3<real> const r = seen.row(0), s = seen.row(1);
    real const rr = dot(r, r), rs = dot(r, s), ss = dot(s, s);
    real const unit = real(scale) / (rr * ss - rs * rs);
    auto const axis = [&](real p, real q) {
      return vec3<float>{((p * r.x + q * s.x) * unit).value, ((p * r.y + q * s.y) * unit).value,
                         ((p * r.z + q * s.z) * unit).value};
    };
    patch.across = axis(ss, -rs);
    patch.down = axis(-rs, rr);
  }
};

}  // namespace detail

/// Positions of keypoints: of each that holds a map point with a patch where the image looks like
/// it, at most 6 pixels of its level away along each axis; of others, and where there is no such
/// place, their own. Asynchronous on `exec`; allocates nothing; one launch.
template <typename Exec, typename Rig>
void align_keypoints(Exec const& exec, frames_to_align<Rig> const& in) {
  for_each_item<per_warp>(exec, in.frame.batch * in.frame.numbers(), detail::align_keypoint<Rig>{},
                          in);
}

/// Keeps what the image looks like around points that a new keyframe holds and that have no patch
/// yet. After insert_keyframe(), whose workspace it reads. Asynchronous on `exec`; allocates
/// nothing; one launch.
template <typename Exec, typename Rig>
void keep_patches(Exec const& exec, keyframe_input<Rig> const& in, image_pyramid_view const& images,
                  odometry_map_view const& map, keyframe_workspace const& work,
                  point_patches_view const& to) {
  for_each_item<per_warp>(exec, in.frame.batch * in.frame.numbers(), detail::keep_patch<Rig>{}, in,
                          images, map, work, to);
}

}  // namespace FT_ABI
}  // namespace ft
