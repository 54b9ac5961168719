// SPDX-License-Identifier: Apache-2.0
/// @file Stages: new points of a keyframe of one camera, from matches with earlier keyframes along
/// epipolar lines. Source: Mur-Artal, Montiel and Tardos, "ORB-SLAM: a versatile and accurate
/// monocular SLAM system", T-RO 2015, section VI.
#pragma once

#include <cstddef>
#include <cstdint>

#include "ft/containers/frame.hpp"
#include "ft/containers/image_pyramid.hpp"
#include "ft/containers/keyframes.hpp"
#include "ft/containers/odometry_map.hpp"
#include "ft/core/arithmetic.hpp"
#include "ft/core/atomics.hpp"
#include "ft/core/config.hpp"
#include "ft/core/execution.hpp"
#include "ft/core/group.hpp"
#include "ft/core/memory.hpp"
#include "ft/kernels/map/detail/bin_rays.hpp"
#include "ft/kernels/map/keyframe_input.hpp"
#include "ft/kernels/map/point_masks.hpp"
#include "ft/types/poses.hpp"
#include "ft/types/tracking.hpp"

namespace ft {
inline namespace FT_ABI {

struct triangulation_params {
  int max_hamming = detail::descriptor_scale::limit(50);  ///< see search_params
  int min_shared = 15;         ///< points that an earlier keyframe shares with the frame
  double max_cosine = 0.9998;  ///< of the angle between the rays of a point
  double chi2 = 5.991;         ///< largest reprojection error, in units of variance
  double octave_slack = 1.8;   ///< of the ratio of distances, to that of octaves
  /// Whether a point needs other matches that agree with it; see least_support(). It keeps the
  /// scale of a map that nothing else keeps, at the cost of half of the points.
  bool needs_support = true;
};

/// Earlier keyframes with which a frame is matched.
inline constexpr int max_partners = 10;
inline constexpr std::uint32_t no_claim = 0xffffffffu;

/// New points of frames that become keyframes. Executor memory.
struct triangulated_view {
  int* partner = nullptr;          ///< [batch][max_partners] numbers of keyframes, 0 = none
  int* keyframe = nullptr;         ///< [batch][capacity] number of the keyframe that sees the point
  int* keypoint = nullptr;         ///< [batch][capacity] and its keypoint; -1 = no point
  std::uint32_t* rank = nullptr;   ///< [batch][capacity] distance, then keypoint: lower ones win
  std::uint32_t* claim = nullptr;  ///< [batch][positions][capacity] best rank of a keypoint
  float* depth = nullptr;          ///< [batch][capacity] -1 = no point
  vec3<float>* point = nullptr;    ///< [batch][capacity] in the camera's frame
};

inline void carve(carver& c, triangulated_view& v, keyframes_capacity const& size, int batch) {
  c.place({batch, max_partners}, v.partner);
  c.place({batch, size.keypoints}, v.keyframe, v.keypoint, v.rank);
  c.place({batch, size.keypoints, size.positions}, v.claim);
  c.place({batch, size.keypoints}, v.depth, v.point);
}

/// Inputs of the stages below.
template <typename Rig>
struct triangulation_input {
  Rig rig;
  frame_view frame;
  keyframe_order const* order = nullptr;   ///< [batch]
  keyframe_order const* begins = nullptr;  ///< [batch] begin_map: the map is new, without partners
  rigid<double> const* T_cw = nullptr;     ///< [batch]
  pyramid_geometry geometry;
  triangulation_params params;
};

namespace detail {

template <typename Rig>
FT_HOST_DEVICE vec3<float> ray_of(Rig const& rig, pyramid_geometry const& geometry,
                                  keypoints_view const& kp, int i) {
  using real = strict_double;
  int const octave = kp.octave(i);
  auto const seen = rig.camera.template cast<real>().unproject(
      {real(static_cast<double>(geometry.column(kp.x(i), octave))),
       real(static_cast<double>(geometry.row(kp.y(i), octave)))});
  auto const& d = seen.direction;
  real const length = scalar::sqrt(dot(d, d));
  if (!seen.valid || !(d.z > real(0)) || !scalar::is_finite(length)) { return {0, 0, 0}; }
  return {static_cast<float>((d.x / length).value), static_cast<float>((d.y / length).value),
          static_cast<float>((d.z / length).value)};
}

/// How far a match may be from its epipolar line at octave 0, share of the focal length.
template <typename Rig>
FT_HOST_DEVICE strict_double line_width(Rig const& rig) {
  return strict_double(2.5) / strict_double(static_cast<double>(rig.camera.fx));
}

/// Item: a batch entry. Chooses the keyframes that share most points with the frame.
template <typename Rig>
struct choose_partners {
  struct scratch {
    int votes[max_keyframes];
  };
  template <typename Group>
  FT_HOST_DEVICE void operator()(Group g, scratch& s, int b, triangulation_input<Rig> const& in,
                                 odometry_map_view const& map, keyframe_rays_view const& rays,
                                 triangulated_view const& out) const {
    keyframes_view const& kf = map.keyframes;
    for (int p = g.rank(); p < max_keyframes; p += g.size()) { s.votes[p] = 0; }
    for (int i = g.rank(); i < max_partners; i += g.size()) {
      out.partner[b * max_partners + i] = 0;
    }
    g.sync();
    if (in.order[b] != keyframe_order::add || in.begins[b] == keyframe_order::begin_map) { return; }
    auto const first = static_cast<std::ptrdiff_t>(b) * in.frame.numbers();
    int const n = *in.frame.camera(b, 0).count;
    for (int i = g.rank(); i < n; i += g.size()) {
      int const slot = in.frame.holder[first + i];
      if (!map.records.holds_point(b, slot)) { continue; }
      each_position(map.records.mask(b, slot), map.records.words,
                    [&](int p) { atomic_add(s.votes + p, 1); });
    }
    g.sync();
    if (g.rank() != 0) { return; }
    for (int k = 0; k < max_partners; ++k) {
      int best = 0;
      int most = in.params.min_shared - 1;
      for (int number = kf.oldest(b); number <= kf.made[b]; ++number) {
        int const p = kf.position(number);
        if (s.votes[p] >= most + 1 && rays.number[kf.at(b, p)] == number) {
          most = s.votes[p];
          best = number;
        }
      }
      out.partner[b * max_partners + k] = best;
      if (best == 0) { break; }
      s.votes[kf.position(best)] = 0;
    }
  }
};

/// Item: a keypoint of a keyframe position. Nothing claims it.
struct clear_claim {
  using scratch = no_scratch;
  template <typename Group>
  FT_HOST_DEVICE void operator()(Group, scratch&, int item, int each, int const* partner,
                                 triangulated_view const& out) const {
    if (partner[item / each * max_partners] != 0) { out.claim[item] = no_claim; }
  }
};

/// The relation of two cameras.
struct camera_pair {
  using real = strict_double;
  rigid<real> T_21;
  rigid<real> T_12;
};

/// Item: a keypoint of a frame. Matches it with the keypoints of its partners, and keeps the match
/// that most others agree with.
template <typename Rig>
struct match_along_lines {
  using scratch = no_scratch;
  using real = strict_double;

  template <typename Group>
  FT_HOST_DEVICE void operator()(Group g, scratch&, int item, triangulation_input<Rig> const& in,
                                 odometry_map_view const& map, keyframe_rays_view const& rays,
                                 triangulated_view const& out) const {
    int const b = item / in.frame.capacity();
    int const i = item % in.frame.capacity();
    keypoints_view const kp = in.frame.camera(b, 0);
    if (g.rank() == 0) {
      out.keypoint[item] = -1;
      out.keyframe[item] = 0;
      out.depth[item] = -1.0f;
    }
    int const* const partner = out.partner + b * max_partners;
    if (partner[0] == 0 || i >= *kp.count) { return; }
    if (map.records.holds_point(b, in.frame.holder[item])) { return; }
    vec3<float> const narrow = ray_of(in.rig, in.geometry, kp, i);
    if (!(narrow.z > 0)) { return; }
    vec3<real> const f1 = narrow.cast<real>();
    descriptor const orb = kp.orb(i);
    auto const T_1w = in.T_cw[b].template cast<real>();
    match_candidate found[max_partners];
    int count = 0;
    int partners = 0;
    for (int k = 0; k < max_partners && partner[k] != 0; ++k) {
      ++partners;
      auto const T_2w = pose_at(map.keyframes, b, partner[k]);
      camera_pair const T{T_2w * T_1w.inverse(), T_1w * T_2w.inverse()};
      match const m = nearest(g, in, map.keyframes, map.records, rays, b, partner[k], T, f1, orb);
      if (m.keypoint < 0) { continue; }
      triangulate(in, map.keyframes, rays, b, i, partner[k], T, f1, m, found[count]);
      count += static_cast<int>(found[count].keyframe != 0);
    }
    int const chosen = most_supported(
        g, found, count, in.params.needs_support ? least_support(partners) : 0,
        [&](int of, int by) {
          vec3<real> const p = T_1w.inverse() * found[of].point.template cast<real>();
          return agrees_at(in, map.keyframes, b, found[by].keyframe, found[by].keypoint, p);
        });
    if (g.rank() != 0 || chosen < 0) { return; }
    match_candidate const& best = found[chosen];
    out.keyframe[item] = best.keyframe;
    out.keypoint[item] = best.keypoint;
    out.rank[item] =
        static_cast<std::uint32_t>(best.distance) << 23 | static_cast<std::uint32_t>(i);
    out.depth[item] = best.point.z;
    out.point[item] = best.point;
    std::ptrdiff_t const to =
        map.keyframes.at(b, map.keyframes.position(best.keyframe), best.keypoint);
    atomic_min(reinterpret_cast<unsigned*>(out.claim + to), static_cast<unsigned>(out.rank[item]));
  }

private:
  struct match {
    int keypoint;
    int distance;
  };

  FT_HOST_DEVICE static rigid<real> pose_at(keyframes_view const& kf, int b, int number) {
    return kf.T_cw[kf.at(b, kf.position(number))].template cast<real>();
  }
  /// Whether a point of the world is seen where a keyframe has a keypoint.
  FT_HOST_DEVICE static bool agrees_at(triangulation_input<Rig> const& in, keyframes_view const& kf,
                                       int b, int number, int keypoint, vec3<real> p) {
    std::ptrdiff_t const at = kf.at(b, kf.position(number), keypoint);
    return agrees(in, pose_at(kf, b, number) * p, kf.x[at], kf.y[at], kf.octave[at]);
  }

  /// The most similar free keypoint of a keyframe near the epipolar line.
  template <typename Group>
  FT_HOST_DEVICE static match nearest(Group g, triangulation_input<Rig> const& in,
                                      keyframes_view const& kf, point_records_view const& records,
                                      keyframe_rays_view const& rays, int b, int number,
                                      camera_pair const& T, vec3<real> f1, descriptor const& orb) {
    vec3<real> const normal = cross(T.T_21.t, T.T_21.R * f1);
    real const length = scalar::sqrt(dot(normal, normal));
    int const p = kf.position(number);
    std::ptrdiff_t const first = kf.at(b, p, 0);
    std::uint32_t best = no_claim;
    real const pixel = line_width(in.rig);
    auto const compare = [&](int j) {
      // First what refuses most for the least.
      std::ptrdiff_t const at = first + j;
      vec3<real> const f2 = rays.ray[at].template cast<real>();
      real const off = scalar::abs(dot(f2, normal));
      real const limit = pixel * real(static_cast<double>(in.geometry.scale[kf.octave[at]]));
      if (!(off <= limit * length) || !(f2.z > real(0))) { return; }
      int const distance = search_distance(orb, rays.orb[at]);
      if (distance > in.params.max_hamming) { return; }
      int const slot = kf.holder[at];
      bool const held = slot >= 0 && records.number[records.at(b, slot)] == kf.holder_number[at];
      if (held) { return; }
      std::uint32_t const key =
          static_cast<std::uint32_t>(distance) << 23 | static_cast<std::uint32_t>(j);
      best = key < best ? key : best;
    };
    vec3<float> const unit = scaled(normal, real(1) / length).template cast<float>();
    std::ptrdiff_t const row = kf.at(b, p);
    ray_cell const* const cell = rays.cell + row * ray_cells;
    int const* const start = rays.first + row * (ray_cells + 1);
    for (int c = g.rank(); c < ray_cells; c += g.size()) {
      // A NaN refuses here, as it does in each comparison.
      if (!(scalar::abs(dot(unit, cell[c].middle)) <= cell[c].reach)) { continue; }
      for (int k = start[c]; k < start[c + 1]; ++k) { compare(rays.in_cell[first + k]); }
    }
    best = g.reduce(best, min_op{});
    if (best == no_claim) { return {-1, 0}; }
    return {static_cast<int>(best & 0x7fffffu), static_cast<int>(best >> 23)};
  }

  /// Writes the point of two rays, if it is good.
  FT_HOST_DEVICE static void triangulate(triangulation_input<Rig> const& in,
                                         keyframes_view const& kf, keyframe_rays_view const& rays,
                                         int b, int i, int number, camera_pair const& T,
                                         vec3<real> f1, match const& m, match_candidate& out) {
    std::ptrdiff_t const at = kf.at(b, kf.position(number), m.keypoint);
    vec3<real> const d2 = T.T_12.R * rays.ray[at].template cast<real>();
    vec3<real> const c2 = T.T_12.t;
    real const a = dot(f1, d2);
    real const limit = in.params.max_cosine;
    if (!(a < limit)) { return; }
    real const denominator = real(1) - a * a;
    real const on_first = dot(c2, f1);
    real const on_second = dot(c2, d2);
    real const l1 = (on_first - a * on_second) / denominator;
    real const l2 = (a * on_first - on_second) / denominator;
    if (!(l1 > real(0)) || !(l2 > real(0))) { return; }
    vec3<real> const sum = scaled(f1, l1) + c2 + scaled(d2, l2);
    vec3<real> const p1 = scaled(sum, real(0.5));
    vec3<real> const p2 = T.T_21 * p1;
    keypoints_view const kp = in.frame.camera(b, 0);
    int const o1 = kp.octave(i);
    int const o2 = kf.octave[at];
    if (!agrees(in, p1, in.geometry.column(kp.x(i), o1), in.geometry.row(kp.y(i), o1), o1) ||
        !agrees(in, p2, kf.x[at], kf.y[at], o2)) {
      return;
    }
    real const by_distance = scalar::sqrt(dot(p2, p2)) / scalar::sqrt(dot(p1, p1));
    real const by_octave = real(static_cast<double>(in.geometry.scale[o1])) /
                           real(static_cast<double>(in.geometry.scale[o2]));
    real const slack = in.params.octave_slack;
    if (!(by_distance * slack >= by_octave && by_distance <= by_octave * slack)) { return; }
    vec3<float> const point{static_cast<float>(p1.x.value), static_cast<float>(p1.y.value),
                            static_cast<float>(p1.z.value)};
    out = {number, m.keypoint, m.distance, a, point};
  }

  FT_HOST_DEVICE static bool agrees(triangulation_input<Rig> const& in, vec3<real> p, float x,
                                    float y, int octave) {
    if (!(p.z > real(0))) { return false; }
    auto const seen = in.rig.camera.template cast<real>().project(p);
    real const dx = seen.pixel.x - real(static_cast<double>(x));
    real const dy = seen.pixel.y - real(static_cast<double>(y));
    real const chi2 =
        (dx * dx + dy * dy) * real(static_cast<double>(in.geometry.inv_sigma2[octave]));
    return seen.valid && chi2 <= real(in.params.chi2);
  }
};

/// Item: a keypoint of a frame. Drops its point if another keypoint has the same match.
struct keep_claim {
  using scratch = no_scratch;
  template <typename Group>
  FT_HOST_DEVICE void operator()(Group, scratch&, int item, keyframes_view const& kf,
                                 triangulated_view const& out) const {
    if (out.keypoint[item] < 0) { return; }
    int const b = item / kf.capacity;
    std::ptrdiff_t const at = kf.at(b, kf.position(out.keyframe[item]), out.keypoint[item]);
    if (out.claim[at] == out.rank[item]) { return; }
    out.keypoint[item] = -1;
    out.depth[item] = -1.0f;
  }
};

/// Item: a keypoint of a new keyframe. After insert_keyframe: keeps its ray and descriptor, and
/// enters its new point in the keyframe that it was triangulated with.
template <typename Rig>
struct enter_partner {
  using scratch = no_scratch;
  /// @param with false: no keypoint has a partner
  template <typename Group>
  FT_HOST_DEVICE void operator()(Group, scratch&, int item, triangulation_input<Rig> const& in,
                                 bool with, odometry_map_view const& map,
                                 keyframe_rays_view const& rays,
                                 triangulated_view const& from) const {
    int const b = item / in.frame.capacity();
    int const i = item % in.frame.capacity();
    if (in.order[b] == keyframe_order::none) { return; }
    keyframes_view const& kf = map.keyframes;
    int const p = kf.position(kf.made[b]);
    if (i == 0) { rays.number[kf.at(b, p)] = kf.made[b]; }
    keypoints_view const kp = in.frame.camera(b, 0);
    if (i >= *kp.count) { return; }
    rays.ray[kf.at(b, p, i)] = ray_of(in.rig, in.geometry, kp, i);
    rays.orb[kf.at(b, p, i)] = kp.orb(i);
    if (!with || from.keypoint[item] < 0) { return; }
    int const number = from.keyframe[item];
    int const slot = in.frame.holder[item];
    if (slot < 0 || !kf.holds(b, number)) { return; }
    int const q = kf.position(number);
    std::ptrdiff_t const at = kf.at(b, q, from.keypoint[item]);
    kf.holder[at] = slot;
    kf.aligned[at] = 0;
    kf.holder_number[at] = map.records.number[map.records.at(b, slot)];
    map.records.mask(b, slot)[q / 64] |= std::uint64_t{1} << (q % 64);
    get<field::observations>(map.points.slice(b), slot) = map.records.observers(b, slot);
  }
};

}  // namespace detail

/// Finds points of frames that become keyframes, for keypoints that hold none: `out.depth` and
/// `out.point`. Each keypoint is matched with free keypoints of those earlier keyframes that share
/// most points with the frame, by descriptors along epipolar lines. Of its matches the one makes
/// the point that most of the others agree with, of equals the one whose rays have the widest
/// angle; with three keyframes or more it needs the agreement of one other, with six or more of
/// two. Of several keypoints with the same match the one with the smallest Hamming distance has it,
/// of equals the first. Asynchronous on `exec`; allocates nothing; four launches.
template <typename Exec, typename Rig>
void triangulate_points(Exec const& exec, triangulation_input<Rig> const& in,
                        odometry_map_view const& map, keyframe_rays_view const& rays,
                        triangulated_view const& out) {
  int const numbers = in.frame.batch * in.frame.capacity();
  int const each = map.keyframes.positions * map.keyframes.capacity;
  for_each_item<per_block<256>>(exec, in.frame.batch, detail::choose_partners<Rig>{}, in, map, rays,
                                out);
  for_each_item<per_thread>(exec, in.frame.batch * each, detail::clear_claim{}, each,
                            static_cast<int const*>(out.partner), out);
  for_each_item<per_warp>(exec, numbers, detail::match_along_lines<Rig>{}, in, map, rays, out);
  for_each_item<per_thread>(exec, numbers, detail::keep_claim{}, map.keyframes, out);
}

/// After insert_keyframe: keeps rays and descriptors of the new keyframes, and enters new points in
/// the keyframes that they were triangulated with. Asynchronous on `exec`; allocates nothing; two
/// launches.
/// @param with whether points were triangulated; `from` is not read otherwise
template <typename Exec, typename Rig>
void enter_partners(Exec const& exec, triangulation_input<Rig> const& in, bool with,
                    odometry_map_view const& map, keyframe_rays_view const& rays,
                    triangulated_view const& from) {
  for_each_item<per_thread>(exec, in.frame.batch * in.frame.capacity(),
                            detail::enter_partner<Rig>{}, in, with, map, rays, from);
  bin_rays(
      exec,
      {in.order, map.keyframes, in.geometry, static_cast<float>(detail::line_width(in.rig).value)},
      rays);
}

}  // namespace FT_ABI
}  // namespace ft
