// SPDX-License-Identifier: Apache-2.0
/// @file Stage: takes over the pose of a frame from its map points and its IMU.
#pragma once

#include <cstddef>

#include "ft/containers/frame.hpp"
#include "ft/containers/inertial.hpp"
#include "ft/containers/map_points.hpp"
#include "ft/core/arithmetic.hpp"
#include "ft/core/config.hpp"
#include "ft/core/execution.hpp"
#include "ft/core/group.hpp"
#include "ft/kernels/inertial/predict.hpp"
#include "ft/kernels/odometry/begin_inertial.hpp"
#include "ft/kernels/odometry/image_changes.hpp"
#include "ft/kernels/odometry/inertial_track.hpp"
#include "ft/kernels/odometry/state.hpp"
#include "ft/kernels/pose/pose_problem.hpp"
#include "ft/math/small_matrices.hpp"
#include "ft/math/so3.hpp"
#include "ft/types/imu.hpp"
#include "ft/types/poses.hpp"

namespace ft {
inline namespace FT_ABI {
/// Frames whose poses may be replaced by those with their IMUs.
struct inertial_frames {
  observations_view seen;
  odometry_state_view state;
  frame_view frame;
  float const* information;      ///< [batch][information_terms] of the poses of the images, or null
  pose* T_cw;                    ///< [batch] in: by the images alone
  image_changes_view changes{};  ///< of the images; where there are none, none is blurred
};

namespace detail {

/// A frame of which a smaller share than one in so many keypoints agrees with its pose tells little
/// of it.
inline constexpr int weak_share = 10;
/// After so many frames whose map points it contradicts, and none between where both agree, it is
/// the IMU's state that is wrong.
inline constexpr int most_contradictions = 3;
/// So many matches that agree with one another are no accident: where the IMU is against more than
/// one in eight of them, its samples or its state are wrong.
inline constexpr int outvoting_matches = 80;

/// @param with inliers of the pose with the IMU @param without of the pose of the images alone
FT_HOST_DEVICE inline bool images_allow(int with, int without) {
  return without >= outvoting_matches ? 8 * with >= 7 * without : 2 * with >= without;
}

/// Turns of gyroscope and images differ by no more than this, and by this share, rad. A bias of
/// 0.1 rad/s, before it is known, is 5 mrad at 20 frames a second.
inline constexpr double turn_difference = 0.02, turn_share = 0.05;
/// A pose with the IMU is farther from that of many matches than their errors explain: above this
/// square of the distance, in standard deviations.
inline constexpr float most_deviations2 = 30;

/// Whether the gyroscope turned between two frames as the images say.
/// @param from, to T_cw by the images
FT_HOST_DEVICE inline bool turns_agree(preintegrated const& integral, imu_bias const& bias,
                                       imu_mount const& mount, rigid<double> const& from,
                                       rigid<double> const& to) {
  mat3<real64> const R_bc = mount.T_bc.R.template cast<real64>();
  mat3<real64> const seen = R_bc * from.R.template cast<real64>() *
                            to.R.template cast<real64>().transposed() * R_bc.transposed();
  mat3<real64> const measured = change_bias(integral, bias).dR.template cast<real64>();
  vec3<real64> const off = rotation_log(measured.transposed() * seen);
  vec3<real64> const turn = rotation_log(seen);
  real64 const most = real64(turn_difference) + real64(turn_share) * scalar::sqrt(dot(turn, turn));
  return dot(off, off) <= most * most;
}

/// The square of a pose's distance from another, in standard deviations of that one.
/// @param information of `of`: upper triangle by rows, of a twist of its camera, rotation first
FT_HOST_DEVICE inline float deviations2(pose const& of, pose const& other,
                                        float const* information) {
  rigid<real64> const d = of.template cast<real64>() * other.template cast<real64>().inverse();
  vec3<real64> const w = rotation_log(d.R);
  real64 const x[6] = {w.x, w.y, w.z, d.t.x, d.t.y, d.t.z};
  real64 sum = 0.0;
  int at = 0;
  for (int i = 0; i < 6; ++i) {
    for (int j = i; j < 6; ++j) {
      real64 const term = x[i] * x[j] * real64(static_cast<double>(information[at++]));
      sum += i == j ? term : term + term;
    }
  }
  return static_cast<float>(sum.value);
}

/// Whether more than half of a camera's images that are there are sharp in one direction only.
/// Their keypoints lie at ends of streaks, all displaced alike. The covariance of a pose does not
/// know that.
FT_HOST_DEVICE inline bool is_blurred(inertial_frames const& in, int b) {
  int images = 0, streaked = 0;
  for (int c = 0; in.changes.of != nullptr && c < in.frame.cameras; ++c) {
    int const image = in.frame.image(b, c);
    if (in.changes.is_missing(image)) { continue; }
    ++images;
    streaked += in.changes.of[image].streaked;
  }
  return 2 * streaked > images;
}

FT_HOST_DEVICE inline bool is_near(pose const& seen, stored_inertial_state const& other,
                                   float const* information, float most2) {
  return deviations2(seen, pose_of(other).template cast<float>(), information) <= most2;
}

/// Item: a camera. Takes the pose over where it was optimised.
struct take_inertial_pose {
  using scratch = no_scratch;

  template <typename Group>
  FT_HOST_DEVICE void operator()(Group g, scratch&, int b, inertial_frames const& in,
                                 inertial_view const& v) const {
    observations_view const& seen = in.seen;
    inertial_track& t = v.tracks[b];
    inertial_pose_result const& result = v.poses.result[b];
    // A camera that was lost has been searched for with a wide radius: too many wrong matches.
    search_plan const plan = in.state.tracks[b].plan;
    bool const optimizes = t.source != inertial_source::none && plan == search_plan::follow;
    bool const optimized = optimizes && result.status == inertial_pose_status::optimised;
    bool const is_last = g.rank() == g.size() - 1;
    pose T{};
    if (is_last && optimized) { T = pose_of(result.stored).template cast<float>(); }
    auto const at = static_cast<std::ptrdiff_t>(b) * seen.capacity;
    int* const holder = in.frame.holder + static_cast<std::ptrdiff_t>(b) * in.frame.numbers();
    int const n = optimized ? seen.count[b] : 0;
    // What the visual optimisation has released stays so.
    int inliers = 0;
    for (int i = g.rank(); i < n; i += g.size()) {
      bool const holds = holder[seen.number[at + i]] >= 0;
      inliers += static_cast<int>(holds && seen.outlier[at + i] == 0);
    }
    inliers = g.reduce(inliers, sum_op{});
    bool const many = plan != search_plan::nothing && seen.inliers[b] >= outvoting_matches;
    // All threads decide, before one of them changes what they read.
    float const* const information =
        in.information == nullptr
            ? nullptr
            : in.information + static_cast<std::ptrdiff_t>(b) * information_terms;
    bool const near = !optimized || !many || information == nullptr || is_blurred(in, b) ||
                      is_near(in.T_cw[b], result.stored, information, most_deviations2);
    bool const turned = !many || t.sees == 0 || !usable(v.from_last(b).status) ||
                        turns_agree(v.from_last(b), t.last.bias, v.mount, t.seen,
                                    in.T_cw[b].template cast<double>());
    bool const taken = optimized && near && turned && images_allow(inliers, seen.inliers[b]);
    g.sync();
    for (int i = g.rank(); taken && i < n; i += g.size()) {
      if (seen.outlier[at + i] != 0) { holder[seen.number[at + i]] = -1; }
    }
    if (!is_last) { return; }
    t.seen = in.T_cw[b].template cast<double>();
    t.gyro_agrees = many && t.sees != 0 && turned && usable(v.from_last(b).status) ? 1 : 0;
    t.sees = many ? 1 : 0;
    t.optimized = taken ? 1 : 0;
    if (taken) {
      t.contradicted = t.doubted = 0;
      seen.inliers[b] = inliers;
      in.T_cw[b] = T;
    } else if (optimizes || !turned) {
      bool const again = optimizes && t.doubted != 0;
      bool const outvoted =
          contradict(t, optimized || !turned, seen.inliers[b], v.from_keyframe(b));
      if (outvoted && again) { forget_state(t); }
    }
    int keypoints = 0;
    for (int c = 0; c < in.frame.cameras; ++c) { keypoints += *in.frame.camera(b, c).count; }
    t.weak = weak_share * seen.inliers[b] < keypoints ? 1 : 0;
  }

private:
  /// Map points and IMU contradict each other. A blurred image has wrong matches that agree with
  /// one another, so the IMU is right, but not again and again, nor against many matches. Of these
  /// the pose stays, and what was integrated enters nothing.
  /// @return whether many matches have outvoted it
  FT_HOST_DEVICE static bool contradict(inertial_track& t, bool optimized, int& inliers,
                                        preintegrated& from_keyframe) {
    ++t.contradicted;
    bool const outvoted = optimized && inliers >= outvoting_matches;
    if (outvoted) {
      t.doubted = 1;
      t.status = from_keyframe.status = integration_status::contradicted;
    } else if (optimized && t.contradicted < most_contradictions) {
      inliers = 0;
      return false;
    }
    t.contradicted = 0;
    t.keyframe_moves = 0;
    t.source = inertial_source::none;
    return outvoted;
  }
  /// An estimate after the contradiction is outvoted, too: so are those that it was joined with. A
  /// bias is another one than before, and their mean would take long to follow.
  FT_HOST_DEVICE static void forget_state(inertial_track& t) {
    int const restarts = t.restarts;
    t.begin_anew();
    t.restarts = restarts;  // the integrals are as good as before
  }
};

}  // namespace detail

/// Replaces poses and inliers by those of optimize_inertial_poses(), where that was not refused, at
/// least half of the visual inliers agree, or seven in eight of 80 or more, and the camera is not
/// searched for. With 80 or more the gyroscope must have turned as the images, and the pose must be
/// as near to theirs as their errors explain, unless the images are blurred by a motion, which
/// displaces all keypoints alike. Keypoints that are outliers release their points.
/// Where fewer agree, and there are fewer than 80, the frame has no inliers, so that it is not
/// tracked. The third such frame, if none in between agreed, and any with more keep their visual
/// pose, and the IMU says nothing until an estimate gives velocities anew; with more, the integral
/// from the newest keyframe is dropped as `contradicted`, and if that was so before and no pose has
/// agreed since, all estimates are forgotten. Asynchronous on `exec`; allocates
/// nothing; one launch.
template <typename Exec>
void take_inertial_poses(Exec const& exec, inertial_frames const& in, inertial_view const& v) {
  for_each_item<per_block<1024>>(exec, v.batch, detail::take_inertial_pose{}, in, v);
}

}  // namespace FT_ABI
}  // namespace ft
