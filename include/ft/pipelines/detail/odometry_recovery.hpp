// SPDX-License-Identifier: Apache-2.0
/// @file Finds lost cameras of an odometry by words, in calls beside the recorded frame.
#pragma once

#include <algorithm>
#include <cstddef>
#include <cstdint>
#include <memory>

#include "ft/cameras/stereo_rig.hpp"
#include "ft/containers/keypoints.hpp"
#include "ft/containers/vocabulary.hpp"
#include "ft/core/arithmetic.hpp"
#include "ft/core/config.hpp"
#include "ft/core/error.hpp"
#include "ft/core/execution.hpp"
#include "ft/core/memory.hpp"
#include "ft/kernels/odometry/recovery_evidence.hpp"
#include "ft/kernels/odometry/settle_lost.hpp"
#include "ft/kernels/pose/optimize_frame.hpp"
#include "ft/kernels/words/keyframe_words.hpp"
#include "ft/kernels/words/query_database.hpp"
#include "ft/kernels/words/transform.hpp"
#include "ft/pipelines/detail/odometry_part.hpp"
#include "ft/pipelines/detail/odometry_stages.hpp"
#include "ft/pipelines/detail/rig_parts.hpp"
#include "ft/pipelines/relocalizer.hpp"
#include "ft/types/poses.hpp"
#include "ft/types/relocalization.hpp"
#include "ft/types/tracking.hpp"

namespace ft {
inline namespace FT_ABI {

/// Plugged into an odometry as the last argument of its constructor: a camera whose frame was not
/// found is also looked up among the keyframes of its map, by the words of a vocabulary. If it is
/// found, it is `tracking` at once. Otherwise a new map may begin, in the frame in which it would
/// without. track() waits for several steps in such a frame, one camera after the other.
///
/// Words of a keyframe are computed after its frame, and leave with the keyframe. Files of maps
/// have none: keyframes of a loaded map are not looked up.
///
/// The constructor throws bad_argument for parameters out of range, a vocabulary without words, an
/// odometry with an IMU, a multi_rig, or a monocular_rig.
struct places {
  vocabulary_view words;  ///< in executor memory, valid as long as the odometry
  place_recovery how = {};
};

namespace detail {

/// Keeps the words of keyframes, and looks up the places of lost cameras. Allocates nothing after
/// its construction.
/// @tparam Rig that is searched as a rectified_rig or a stereo_rig
template <typename Exec, typename Rig>
class odometry_recovery final : public odometry_part<Exec, Rig> {
  static constexpr memory_space space = Exec::space;
  using stages_type = odometry_stages<Exec, Rig>;
  using searched_rig = typename rig_parts<Rig>::searched_rig;

public:
  /// @param stages of the odometry, with all memory
  /// @throws bad_argument for parameters out of range, or a vocabulary that was never made;
  ///   std::bad_alloc, cuda_error
  odometry_recovery(Exec const& exec, vocabulary_view const& words, place_recovery const& params,
                    stages_type const& stages)
      : words_(words), params_(checked(words, params)) {
    keyframes_view const& ring = stages.own.map.keyframes;
    keyframes_capacity const size{ring.positions, ring.cameras, ring.capacity};
    int const numbers = ring.numbers();
    memory_ = owner<memory, space>([&](carver& c, memory& m) {
      auto const b = static_cast<std::size_t>(ring.batch);
      carve(c, m.keyframes, size, words.words, ring.batch);
      carve(c, m.descriptors, numbers, ring.batch);
      carve(c, m.words, ring.batch, numbers);
      carve(c, m.transform, ring.batch, numbers);
      carve(c, m.query, 1, m.keyframes.slice(0).database);
      carve(c, m.candidates, 1, ring.positions);
      carve(c, m.observations, numbers, 1);
      m.map = c.template take<int>(1);
      m.first_right = c.template take<int>(1);
      m.live = c.template take<int>(static_cast<std::size_t>(ring.positions) *
                                    static_cast<std::size_t>(numbers));
      m.T_cw = c.template take<pose>(b);
      m.inliers = c.template take<int>(b);
      m.evidence = c.template take<std::int64_t>(b);
      m.begins = c.template take<keyframe_order>(b);
    });
    staging_ = owner<staging, staging_space<Exec>>([&](carver& c, staging& s) {
      auto const b = static_cast<std::size_t>(ring.batch);
      s.wanted = c.template take<int>(b);
      s.outcome = c.template take<place_outcome>(b);
      s.number = c.template take<int>(1);
      s.candidates = c.template take<place_candidate>(static_cast<std::size_t>(ring.positions));
      s.rows = c.template take<int>(static_cast<std::size_t>(params_.candidates));
      s.T_cw = c.template take<pose>(1);
    });
    params_.relocalization.frustum = stages.frustum;
    relocalizer_ = relocalizer<Exec, searched_rig>(
        stages.rig, params_.relocalization,
        {ring.capacity, ring.capacity, stages.own.map.records.slots, params_.candidates});
    clear(exec, memory_->keyframes.database);
    fill_bytes(exec, memory_->map, 0, sizeof(int));
    *staging_->number = ring.capacity;
    copy(exec, memory_->first_right, static_cast<int const*>(staging_->number), 1);
    exec.wait();
  }

  /// After a frame, and the wait for it: keeps the words of new keyframes, looks up lost cameras,
  /// and begins the maps of those that stay lost. Waits, if a camera is lost.
  void after_frame(Exec const& exec, stages_type const& stages) override {
    staging const& s = staging_.view();
    int const batch = stages.own.state.batch;
    bool any = false;
    bool lost = false;
    for (int b = 0; b < batch; ++b) {
      odometry_output const& out = stages.own.outputs[b];
      bool const is_lost =
          out.state == tracking_state::recovering || out.state == tracking_state::lost;
      s.wanted[b] = is_lost || out.keyframe != 0 ? 1 : 0;
      s.outcome[b] = is_lost ? place_outcome::unknown : place_outcome::not_lost;
      any = any || s.wanted[b] != 0;
      lost = lost || is_lost;
    }
    if (!any) { return; }
    find_words(exec, stages.memory.frame);
    keep(exec, stages, stages.own.state.order);
    if (!lost) { return; }
    for (int b = 0; b < batch; ++b) {
      if (s.outcome[b] == place_outcome::unknown && look_up(exec, stages, b)) {
        s.outcome[b] = place_outcome::known;
      }
    }
    settle(exec, stages);
    exec.wait();
  }

  /// Forgets the keyframes of camera b.
  void forget(Exec const& exec, int b, tracking&) override {
    clear(exec, memory_->keyframes.slice(b).database);
  }
  allocated_bytes bytes() const override {
    return {memory_.bytes() + relocalizer_.bytes(), staging_.bytes()};
  }

private:
  struct memory {
    keyframe_words_view keyframes;
    descriptors_view descriptors;  ///< of the frames
    frame_words_view words;        ///< likewise
    transform_workspace transform;
    query_workspace query;
    place_candidates_view candidates;
    observations_view observations;
    int* map = nullptr;                ///< [1] 0
    int* first_right = nullptr;        ///< [1] keypoints of an image, at most
    int* live = nullptr;               ///< [positions][numbers] of the camera that is looked up
    pose* T_cw = nullptr;              ///< [batch] found
    int* inliers = nullptr;            ///< [batch] found
    std::int64_t* evidence = nullptr;  ///< [batch] found
    keyframe_order* begins = nullptr;  ///< [batch]
  };
  struct staging {
    int* wanted = nullptr;             ///< [batch] which a device reads
    place_outcome* outcome = nullptr;  ///< [batch] likewise
    int* number = nullptr;
    place_candidate* candidates = nullptr;  ///< [positions]
    int* rows = nullptr;                    ///< [candidates]
    pose* T_cw = nullptr;
  };

  static place_recovery const& checked(vocabulary_view const& words, place_recovery const& p) {
    require(words.words > 0, "the vocabulary has no words, was never made, or was moved from");
    ft::check(p);
    return p;
  }

  /// Words and groups of the wanted frames.
  void find_words(Exec const& exec, frame_view const& frame) const {
    memory const& m = memory_.view();
    gather_descriptors(exec, frame, staging_->wanted, m.descriptors);
    transform_to_words(exec, words_, m.descriptors, {params_.levels_up}, m.words, m.transform);
    if (frame.cameras > 1) { number_keypoints(exec, frame, m.words.groups); }
  }
  void keep(Exec const& exec, stages_type const& stages, keyframe_order const* order) const {
    keep_keyframe_words(exec, stages.memory.frame, order, stages.own.map.keyframes, memory_->words,
                        memory_->keyframes);
  }

  /// Looks up camera b. @return whether it was found; then its keypoints hold what they see
  bool look_up(Exec const& exec, stages_type const& stages, int b) {
    memory const& m = memory_.view();
    list_live_keyframes(exec, stages.own.map, b, m.keyframes, m.live);
    slot_list const candidates = query(exec, b);
    if (candidates.count == 0) { return false; }
    relocalization_input const in = input_of(stages, b);
    // The time, not a count of frames: a camera's answers do not depend on the batch.
    auto const seed = params_.seed + static_cast<std::uint64_t>(stages.own.inputs[b].time_ns);
    relocalization const found = relocalizer_.relocalize(exec, in, candidates, seed);
    if (!found.found) { return false; }
    // Once more from there, for the outliers and the covariance.
    *staging_->T_cw = found.T_cw;
    copy(exec, m.T_cw + b, static_cast<pose const*>(staging_->T_cw), 1);
    frame_poses poses{m.T_cw + b, m.T_cw + b, m.observations,
                      stages.own.information + static_cast<std::ptrdiff_t>(b) * information_terms};
    poses.observations.inliers = m.inliers + b;
    optimize_frame_poses(exec, stages.rig, {in.frame, in.map, in.geometry}, poses,
                         stages.pose_settings);
    weigh(exec, stages, b, in, candidates.data[found.candidate]);
    exec.wait();
    return true;
  }
  /// The evidence of what was found among the points of a keyframe's first camera.
  void weigh(Exec const& exec, stages_type const& stages, int b, relocalization_input const& in,
             int row) const {
    memory const& m = memory_.view();
    auto search = stages.local_input();
    search.T_cw = m.T_cw + b;
    search.slots = in.holder + in.keyframes.groups.at(row);
    search.slot_count = m.first_right;
    search.centres = nullptr;
    search.radius_factor = nullptr;
    weigh_recoveries(exec, search, stages.own.map.keyframes.capacity, in.frame, in.map,
                     m.inliers + b, m.evidence + b);
  }

  /// Rows of the keyframes that look like frame b, the best first.
  slot_list query(Exec const& exec, int b) const {
    memory const& m = memory_.view();
    staging const& s = staging_.view();
    query_database(exec, {m.words.bag.slice(b, 1), m.map}, m.keyframes.slice(b).database,
                   words_.header.scoring, m.candidates, m.query);
    copy(exec, s.number, static_cast<int const*>(m.candidates.count), 1);
    copy(exec, s.candidates, static_cast<place_candidate const*>(m.candidates.of),
         static_cast<std::size_t>(m.candidates.capacity));
    exec.wait();
    int const count = *s.number;
    std::sort(
        s.candidates, s.candidates + count, [](place_candidate const& x, place_candidate const& y) {
          return x.score != y.score ? x.score > y.score : x.keyframe.number > y.keyframe.number;
        });
    int const kept = min_of(count, params_.candidates);
    for (int i = 0; i < kept; ++i) { s.rows[i] = s.candidates[i].keyframe.slot; }
    return {s.rows, kept};
  }

  relocalization_input input_of(stages_type const& stages, int b) const {
    memory const& m = memory_.view();
    keyframes_view const& ring = stages.own.map.keyframes;
    relocalization_input in;
    in.frame = stages.memory.frame.slice(b);
    in.map = stages.own.map.points.slice(b);
    in.geometry = stages.geometry();
    in.words = {m.words.groups.slice(b, 1), array_of<field::orb>(in.frame.keypoints),
                array_of<field::angle>(in.frame.keypoints),
                searched_rig::cameras == 2 ? m.first_right : nullptr};
    keyframe_words_view const rows = m.keyframes.slice(b);
    in.keyframes = {rows.groups, rows.orb, rows.angle, nullptr};
    auto& kp = in.keyframe_keypoints;
    kp.capacity = ring.capacity;
    kp.batch = ring.positions * ring.cameras;
    kp.count = ring.keypoints + ring.at(b, 0) * ring.cameras;
    static_cast<column<field::angle>&>(kp).data = rows.angle;
    static_cast<column<field::octave>&>(kp).data = ring.octave + ring.at(b, 0, 0);
    in.holder = m.live;
    return in;
  }

  /// States, new maps and results after the look-ups.
  void settle(Exec const& exec, stages_type const& stages) const {
    memory const& m = memory_.view();
    looked_up_frames in;
    in.frame = stages.memory.frame;
    in.outcome = staging_->outcome;
    in.found_T_cw = m.T_cw;
    in.found_inliers = m.inliers;
    in.found_evidence = m.evidence;
    in.T_cw = stages.memory.poses;
    in.inliers = stages.memory.observations.inliers;
    in.matches = stages.memory.local_work.matches;
    in.matched = stages.own.matched;
    in.begins = m.begins;
    settle_lost_frames(exec, stages.settings.rules, in, stages.own.state);
    stages.insert(exec, m.begins);
    keep(exec, stages, m.begins);
    stages.keep_counts(exec);
    stages.pack_matches(exec, stages.outcome_of_local());
    stages.pack_outputs(exec, nullptr);
  }

  vocabulary_view words_;
  place_recovery params_;
  relocalizer<Exec, searched_rig> relocalizer_;
  owner<memory, space> memory_;
  owner<staging, staging_space<Exec>> staging_;
};

template <typename Rig>
inline constexpr bool has_places = false;
template <>
inline constexpr bool has_places<rectified_rig> = true;
template <typename Left, typename Right>
inline constexpr bool has_places<stereo_rig<Left, Right>> = true;

/// @throws bad_argument also for an odometry with an IMU, or a rig whose cameras are not found by
///   words
template <typename Exec, typename Rig>
std::unique_ptr<odometry_part<Exec, Rig>> make_part([[maybe_unused]] places const& given,
                                                    [[maybe_unused]] Exec const& exec,
                                                    odometry_stages<Exec, Rig>& stages) {
  require(describes_images, "words are those of ORB: another FT_DESCRIPTOR has no places");
  require(!stages.settings.imu.present, "places are not recognised by an odometry with an IMU");
  require(!stages.settings.rules.localize_only,
          "places are those of keyframes since the map was loaded: with rules.localize_only none");
  if constexpr (has_places<typename rig_parts<Rig>::searched_rig>) {
    stages.recognizes_places = true;
    return std::make_unique<odometry_recovery<Exec, Rig>>(exec, given.words, given.how, stages);
  } else {
    throw bad_argument("ft: places are not recognised with a rig of one or of several cameras");
  }
}

}  // namespace detail
}  // namespace FT_ABI
}  // namespace ft
