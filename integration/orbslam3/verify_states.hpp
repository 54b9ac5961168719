// SPDX-License-Identifier: Apache-2.0
/// @file What the frustum test writes into map points, and what poses with an IMU leave in frames,
/// to be compared and put back; map points that changed without a hook.
#pragma once

#include <cmath>
#include <cstddef>
#include <limits>
#include <memory>
#include <tuple>
#include <type_traits>
#include <unordered_map>
#include <utility>
#include <vector>

#include "integration/orbslam3/inertial_poses.hpp"
#include "integration/orbslam3/map_mirror.hpp"
#include "integration/orbslam3/verify_report.hpp"

namespace ft::orbslam3 {

/// The members of a map point that the frustum test writes.
template <typename MapPoint>
auto tracked_members(MapPoint& p) {
  return std::tie(p.mbTrackInView, p.mbTrackInViewR, p.mnTrackScaleLevel, p.mnTrackScaleLevelR,
                  p.mTrackProjX, p.mTrackProjY, p.mTrackDepth, p.mTrackViewCos, p.mTrackProjXR,
                  p.mTrackProjYR, p.mTrackDepthR, p.mTrackViewCosR);
}

/// Their values.
using tracked_values =
    std::tuple<bool, bool, int, int, float, float, float, float, float, float, float, float>;

inline bool is_in_view(tracked_values const& t) { return std::get<0>(t) || std::get<1>(t); }
/// @param at index of the point in the local map
inline void add_tracked(readings& to, tracked_values const& t, long at, bool two_cameras,
                        tolerances const& allowed) {
  auto const& [in_view, in_view_right, level, level_right, x, y, depth, cosine, right_x, right_y,
               depth_right, cosine_right] = t;
  to.add("point in view", at, in_view);
  to.add("point in right view", at, in_view_right);
  if (in_view) {
    to.add("octave of point", at, level);
    to.add("x of point", at, x, allowed.pixels);
    to.add("y of point", at, y, allowed.pixels);
    to.add("distance of point", at, depth, allowed.depth);
    to.add("cosine of point", at, cosine, allowed.cosine);
    if (!two_cameras) { to.add("right column of point", at, right_x, allowed.pixels); }
  }
  if (in_view_right) {
    to.add("right octave of point", at, level_right);
    to.add("right x of point", at, right_x, allowed.pixels);
    to.add("right y of point", at, right_y, allowed.pixels);
    to.add("right distance of point", at, depth_right, allowed.depth);
    to.add("right cosine of point", at, cosine_right, allowed.cosine);
  }
}

/// Finds map points that changed without being pushed: a change hook that was forgotten, also where
/// the old value gives the same answers.
template <typename MapPoint>
class hook_watch {
public:
  /// Adds what the device has of a point and the point has no longer. What changes just now is
  /// pushed soon: only what is found in two frames counts, and once for each point.
  void add(difference_log& log, map_mirror<MapPoint>& mirror, MapPoint& p, unsigned long frame) {
    point_fields sent{};
    bool bad = false;
    if (!mirror.copy(&p, sent, bad)) { return; }
    point_fields now = sent;
    bool const is_bad = read_fields(p, now);
    char const* what = nullptr;
    if (bad != is_bad) { what = "bad flag"; }
    if (sent.observed != now.observed) { what = "observations"; }
    if (differ(sent.descriptor, now.descriptor)) { what = "descriptor"; }
    if (differ(sent.normal, now.normal)) { what = "normal"; }
    if (differ(sent.limits, now.limits)) { what = "limits of distance"; }
    if (differ(sent.position, now.position)) { what = "position"; }
    if (what == nullptr) {
      stale_.erase(p.mnId);
      return;
    }
    auto const [known, is_new] = stale_.try_emplace(p.mnId, found{frame, false});
    if (is_new || known->second.told || known->second.frame == frame) { return; }
    known->second.told = true;
    log.add_stale(what, static_cast<long>(p.mnId));
  }

private:
  struct found {
    unsigned long frame;
    bool told;
  };
  std::unordered_map<unsigned long, found> stale_;  ///< by MapPoint::mnId
};

/// What an inertial optimisation changes in a frame and in the last one, so that it can be made
/// several times from the same state.
template <typename Frame>
class inertial_trials {
  using constraint = std::remove_pointer_t<decltype(Frame::mpcpi)>;
  using pose = std::decay_t<decltype(std::declval<Frame&>().GetPose())>;
  using velocity = std::decay_t<decltype(std::declval<Frame&>().GetVelocity())>;

public:
  /// What an optimisation left.
  struct outcome {
    int answer = 0;
    pose T_cw;
    velocity v;
    decltype(Frame::mImuBias) bias;
    std::vector<bool> outliers;
    std::unique_ptr<constraint> prior;
    bool last_prior_used = false;
    readings seen;
  };

  /// @param steps of the integral. Of a single one the information about velocity and position is
  /// rounding errors.
  inertial_trials(Frame& frame, int steps, tolerances const& allowed)
      : frame_(&frame),
        steps_(steps),
        allowed_(allowed),
        last_(frame.mpPrevFrame),
        last_prior_(last_ == nullptr ? nullptr : last_->mpcpi),
        before_(outcome_of(0)) {}

  /// Makes an optimisation and puts all back.
  template <typename Call>
  outcome run(Call const& call) {
    if (last_prior_ != nullptr) { last_->mpcpi = new constraint(*last_prior_); }
    constraint* const own = std::exchange(frame_->mpcpi, nullptr);
    outcome result = outcome_of(call());
    result.prior.reset(std::exchange(frame_->mpcpi, own));
    put(before_);
    if (last_prior_ != nullptr) {
      result.last_prior_used = last_->mpcpi == nullptr;
      delete std::exchange(last_->mpcpi, last_prior_);
    }
    return result;
  }
  /// Leaves in the frames what an optimisation left.
  void keep(outcome& o) {
    put(o);
    if (o.prior != nullptr) { frame_->mpcpi = o.prior.release(); }
    if (o.last_prior_used) { delete std::exchange(last_->mpcpi, nullptr); }
  }

private:
  outcome outcome_of(int answer) const {
    outcome o;
    o.answer = answer;
    o.T_cw = frame_->GetPose();
    o.v = frame_->GetVelocity();
    o.bias = frame_->mImuBias;
    o.outliers = frame_->mvbOutlier;
    o.seen = read(answer);
    return o;
  }
  readings read(int answer) const {
    constexpr double roundings = 2 * std::numeric_limits<float>::epsilon();
    readings r;
    r.add("observations without outliers", -1, answer);
    for (std::size_t i = 0; i < frame_->mvpMapPoints.size(); ++i) {
      if (frame_->mvpMapPoints[i] == nullptr) { continue; }
      r.add("outlier", static_cast<long>(i), frame_->mvbOutlier[i]);
    }
    auto const T_cw = transform_of(frame_->GetPose());
    r.add("rotation entry", T_cw.R, allowed_.turn, roundings);
    r.add("translation entry", T_cw.t, allowed_.position, roundings);
    stored_inertial_state const s = state_of(*frame_);
    r.add("velocity entry", s.v, allowed_.velocity, roundings);
    r.add("gyro bias entry", s.bias.gyro, allowed_.gyro_bias, roundings);
    r.add("accelerometer bias entry", s.bias.accel, allowed_.accel_bias, roundings);
    r.add("prior for the next frame", -1, frame_->mpcpi != nullptr);
    if (steps_ == 1 || frame_->mpcpi == nullptr) { return r; }
    inertial_prior const prior = prior_of(*frame_->mpcpi);
    double const* const H = prior.information;
    for (int i = 0; i < 225; ++i) {
      double const size = std::sqrt(H[i / 15 * 16] * H[i % 15 * 16]);
      r.add("information entry", i, H[i], allowed_.information * size);
    }
    return r;
  }
  void put(outcome const& o) {
    frame_->SetPose(o.T_cw);
    frame_->SetVelocity(o.v);
    frame_->mImuBias = o.bias;
    frame_->mvbOutlier = o.outliers;
  }

  Frame* frame_;
  int steps_;
  tolerances allowed_;
  std::decay_t<decltype(Frame::mpPrevFrame)> last_;
  constraint* last_prior_;
  outcome before_;
};

}  // namespace ft::orbslam3
