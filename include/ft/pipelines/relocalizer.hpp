// SPDX-License-Identifier: Apache-2.0
/// @file Pipeline: the pose of a frame among keyframes that look alike, in memory allocated once.
/// Source: Mur-Artal et al., "ORB-SLAM: a versatile and accurate monocular SLAM system", T-RO 2015,
/// section V-E.
#pragma once

#include <cstddef>
#include <cstdint>
#include <type_traits>
#include <utility>

#include "ft/cameras/stereo_rig.hpp"
#include "ft/containers/frame.hpp"
#include "ft/containers/image_pyramid.hpp"
#include "ft/containers/map_points.hpp"
#include "ft/core/config.hpp"
#include "ft/core/error.hpp"
#include "ft/core/execution.hpp"
#include "ft/core/memory.hpp"
#include "ft/kernels/pnp/solve_pnp.hpp"
#include "ft/kernels/pose/optimize_frame.hpp"
#include "ft/kernels/relocalization/frame_points.hpp"
#include "ft/kernels/search/keyframe.hpp"
#include "ft/kernels/words/search_by_words.hpp"
#include "ft/pipelines/tracker_types.hpp"
#include "ft/types/poses.hpp"
#include "ft/types/relocalization.hpp"

namespace ft {
inline namespace FT_ABI {

/// Frame and keyframes, in executor memory. Rows of keypoints are laid out as in frame_view:
/// keypoint k of camera c is number c * capacity + k.
struct relocalization_input {
  frame_view frame;  ///< of one batch entry
  map_points_view map;
  pyramid_geometry geometry;
  word_keypoints_view words;  ///< the frame's, one row
  word_keypoints_view keyframes;
  /// Of the keyframes; image `cameras * row + c` is that of camera c. Octaves are not read.
  soa_view<field::angle, field::octave> keyframe_keypoints;
  int const* holder = nullptr;  ///< [keyframes][numbers] live map point, -1 = none
};

namespace detail {

/// The camera of a rig that finds points.
template <typename Rig>
auto const& left_camera(Rig const& rig) {
  if constexpr (Rig::rectified) {
    return rig.camera;
  } else {
    return rig.left;
  }
}

}  // namespace detail

/// Relocalises a frame. Calls wait for the executor after each step, since the next one depends on
/// its result. They allocate nothing. Move-only. Not thread-safe; instances are independent.
///
/// Each candidate's matches by words give a pose problem. In rounds, the candidates' next poses are
/// tried in order: the frame holds the inliers' points, its pose is optimised, and if there are
/// few inliers, more of the keyframe's points are searched, coarsely and then in narrow windows.
/// Solver calls of a round are one launch for all candidates.
///
/// After a success `frame.holder` has the points of the frame, among them, as in the reference,
/// maybe outliers: see outliers(). After a failure its content does not matter.
/// @tparam Rig rectified_rig, also for one camera without right columns, or stereo_rig, whose left
///   camera alone is used to find points
template <typename Exec, typename Rig>
class relocalizer {
  static_assert(Rig::searches == 1 && Rig::images == 2, "only rigs of one pair are relocalised");

public:
  static constexpr memory_space space = Exec::space;

  relocalizer() = default;
  /// Read-out times of the rig are not used: keypoints are where a global shutter sees them.
  /// @throws bad_argument for an invalid rig, or parameters or a capacity out of range
  relocalizer(Rig const& rig, relocalization_params const& params,
              relocalizer_capacity const& capacity)
      : rig_(rig), params_(params), capacity_(capacity) {
    rig.check();
    check(params.pnp);
    detail::require_range("keypoints of an image", capacity.keypoints, 1, 1 << 22);
    detail::require_range("keypoints of a keyframe's image", capacity.keyframe_keypoints, 1,
                          1 << 22);
    detail::require_range("slots", capacity.slots, 1, 1 << 28);
    detail::require_range("candidates", capacity.candidates, 1, 1 << 16);
    detail::require_range("rounds", params.rounds, 1, 1 << 20);
    memory_ = owner<memory, space>([&](carver& c, memory& m) { place(c, m); });
    staging_ = owner<staging, staging_space<Exec>>([&](carver& c, staging& s) {
      auto const n = static_cast<std::size_t>(capacity_.candidates);
      s.place = c.template take<int>(n);
      s.row = c.template take<int>(n);
      s.number = c.template take<int>(1);
      s.result = c.template take<pnp_result>(n);
      s.alive = c.template take<int>(n);
      s.T_cw = c.template take<pose>(1);
    });
  }

  /// Matches the frame with each candidate by words: the first step of relocalize(). Waits.
  /// @param candidates rows of keyframes, the best first
  /// @throws bad_argument for inputs of another shape than the constructor's, likewise below
  void match(Exec const& exec, relocalization_input const& in, slot_list candidates) {
    require_shape(in, candidates);
    memory const& m = memory_.view();
    count_ = candidates.count;
    auto const n = static_cast<std::size_t>(count_);
    for (int i = 0; i < count_; ++i) {
      staging_->place[i] = i;
      staging_->row[i] = candidates.data[i];
    }
    copy(exec, m.place, static_cast<int const*>(staging_->place), n);
    copy(exec, m.row, static_cast<int const*>(staging_->row), n);
    fill_bytes(exec, m.frame_row, 0, n * sizeof(int));
    words_search search;
    search.keyframes = in.keyframes;
    search.holder = in.holder;
    search.frames = in.words;
    search.keyframe = m.row;
    search.frame = m.frame_row;
    search_by_words(exec, search, params_.words, matches(), m.words);
    exec.wait();
  }

  /// Relocalises the frame of the last match() with its candidates.
  /// @param seed of the first candidate's samples; each further one has the next number
  /// @param watch watch(step, place of the candidate, value), called after each step
  template <typename Watch>
  relocalization relocalize_matched(Exec const& exec, relocalization_input const& in,
                                    slot_list candidates, std::uint64_t seed, Watch const& watch) {
    require_shape(in, candidates);
    detail::require_range("candidates of match()", count_, candidates.count, candidates.count);
    start(exec, in, seed);
    relocalization out;
    int alive = 0;
    for (int c = 0; c < count_; ++c) { alive += staging_->alive[c]; }
    while (alive > 0 && out.rounds < params_.rounds) {
      ++out.rounds;
      solve(exec);
      alive = 0;
      for (int c = 0; c < count_; ++c) {
        if (staging_->alive[c] == 0) { continue; }
        pnp_result const solved = staging_->result[c];
        bool const any = has_pose(solved.status);
        if (no_more(solved.status)) { staging_->alive[c] = 0; }
        alive += staging_->alive[c];
        if (!any) {
          watch(relocalization_step::solved, c, -1);
          continue;
        }
        out.inliers = try_pose(exec, in, {c, candidates.data[c]}, watch);
        if (out.inliers < params_.enough_inliers) { continue; }
        out.found = true;
        out.candidate = c;
        out.T_cw = frame_pose(exec);
        return out;
      }
    }
    out.inliers = 0;
    return out;
  }

  /// match() and relocalize_matched().
  relocalization relocalize(Exec const& exec, relocalization_input const& in, slot_list candidates,
                            std::uint64_t seed) {
    match(exec, in, candidates);
    return relocalize_matched(exec, in, candidates, seed, [](relocalization_step, int, int) {});
  }

  // Executor memory, valid as long as the relocalizer.
  /// Matches of the candidates of the last match().
  word_matches_view matches() const {
    word_matches_view v = memory_->matches;
    v.pairs = count_;
    return v;
  }
  /// [numbers] 1: an outlier in the last optimisation in which the keypoint held a point.
  unsigned char const* outliers() const { return memory_->state.outlier; }
  /// The frame's pose after the last step. Waits.
  pose frame_pose(Exec const& exec) const {
    copy(exec, staging_->T_cw, static_cast<pose const*>(memory_->state.T_cw), 1);
    exec.wait();
    return *staging_->T_cw;
  }
  std::size_t bytes() const { return memory_.bytes(); }  ///< of executor memory

private:
  using camera_type = std::decay_t<decltype(detail::left_camera(std::declval<Rig const&>()))>;
  struct memory {
    word_matches_view matches;
    words_search_workspace words;
    int* row = nullptr;        ///< [candidates] of the keyframes
    int* frame_row = nullptr;  ///< [candidates] 0
    int* place = nullptr;      ///< [candidates] 0, 1, ...
    int* active = nullptr;     ///< [candidates]
    pnp_problems_view problems;
    pnp_results_view results;
    pnp_workspace solver;
    relocalization_view state;
    observations_view observations;
    search_buffers search;
  };
  struct staging {
    int* place = nullptr;
    int* row = nullptr;
    int* number = nullptr;  ///< one, of read()
    pnp_result* result = nullptr;
    int* alive = nullptr;
    pose* T_cw = nullptr;
  };
  /// A candidate: its place, and the row of its keyframe.
  struct candidate {
    int place, row;
  };

  void place(carver& c, memory& m) const {
    int const numbers = Rig::cameras * capacity_.keypoints;
    int const windows = Rig::cameras * capacity_.keyframe_keypoints;
    auto const n = static_cast<std::size_t>(capacity_.candidates);
    carve(c, m.matches, capacity_.candidates, numbers);
    carve(c, m.words, capacity_.candidates, numbers);
    m.row = c.take<int>(n);
    m.frame_row = c.take<int>(n);
    m.place = c.take<int>(n);
    m.active = c.take<int>(n);
    carve(c, m.problems, capacity_.candidates, capacity_.keypoints);
    m.problems.active = m.active;
    carve(c, m.results, capacity_.candidates, capacity_.keypoints);
    carve(c, m.solver, m.problems, params_.pnp);
    carve(c, m.state, numbers, capacity_.slots, 1);
    carve(c, m.observations, numbers, 1);
    carve(c, m.search.windows, windows, 1, Rig::cameras);
    carve(c, m.search.work, windows, capacity_.keypoints, 1, Rig::cameras);
  }
  void require_shape(relocalization_input const& in, slot_list candidates) const {
    memory_.require_made("relocalizer");
    int const numbers = Rig::cameras * capacity_.keypoints;
    int const keyframe = Rig::cameras * capacity_.keyframe_keypoints;
    detail::require_range("frames", in.frame.batch, 1, 1);
    detail::require_range("cameras of the frame", in.frame.cameras, Rig::cameras, Rig::cameras);
    detail::require_range("keypoints of the frame", in.frame.numbers(), numbers, numbers);
    detail::require_range("keypoints in the frame's words", in.words.groups.capacity, numbers,
                          numbers);
    detail::require_range("keypoints of a keyframe", in.keyframes.groups.capacity, keyframe,
                          keyframe);
    detail::require_range("keypoints of a keyframe's image", in.keyframe_keypoints.capacity,
                          capacity_.keyframe_keypoints, capacity_.keyframe_keypoints);
    detail::require_range("slots of the map", in.map.capacity, capacity_.slots, capacity_.slots);
    detail::require_range("candidates", candidates.count, 0, capacity_.candidates);
    for (int i = 0; i < candidates.count; ++i) {
      detail::require_range("row of a candidate", candidates.data[i], 0,
                            in.keyframes.groups.frames - 1);
    }
  }

  /// Makes the pose problems of all candidates.
  void start(Exec const& exec, relocalization_input const& in, std::uint64_t seed) {
    memory const& m = memory_.view();
    clear(exec, m.state);
    matched_frames from;
    from.frame = in.frame;
    from.map = in.map;
    from.geometry = in.geometry;
    from.matches = matches();
    from.min_matches = params_.min_matches;
    from.chi2 = static_cast<float>(params_.pose.chi2_mono);
    from.seed = seed;
    gather_correspondences(exec, from, problems(), m.active);
    pnp_rays(exec, detail::left_camera(rig_), problems());
    start_pnp(exec, solver());
    copy(exec, staging_->alive, static_cast<int const*>(m.active),
         static_cast<std::size_t>(count_));
    exec.wait();
  }

  // The memory of the problems of this call.
  pnp_problems_view problems() const {
    pnp_problems_view v = memory_->problems;
    v.problems = count_;
    return v;
  }
  pnp_results_view results() const {
    pnp_results_view v = memory_->results;
    v.problems = count_;
    return v;
  }
  pnp_workspace solver() const {
    pnp_workspace v = memory_->solver;
    v.problems = count_;
    return v;
  }

  /// The next pose of each candidate that is left.
  void solve(Exec const& exec) {
    auto const n = static_cast<std::size_t>(count_);
    copy(exec, memory_->active, static_cast<int const*>(staging_->alive), n);
    continue_pnp(exec, detail::left_camera(rig_), problems(), params_.pnp, results(), solver());
    copy(exec, staging_->result, static_cast<pnp_result const*>(memory_->results.result), n);
    exec.wait();
  }

  /// Tries a candidate's pose. @return inliers after the last optimisation
  template <typename Watch>
  int try_pose(Exec const& exec, relocalization_input const& in, candidate const& from,
               Watch const& watch) {
    using step = relocalization_step;
    relocalization_view const& state = memory_->state;
    hold_inliers(exec, in.frame, {problems(), results(), matches(), memory_->place + from.place},
                 state);
    watch(step::solved, from.place, staging_->result[from.place].inliers);
    int n = optimize(exec, in);
    watch(step::first_inliers, from.place, n);
    if (n < params_.min_inliers) { return n; }
    release_outliers(exec, in.frame, state);
    if (n >= params_.enough_inliers) { return n; }
    int const coarse = search(exec, in, from.row, params_.coarse);
    watch(step::coarse_search, from.place, coarse);
    if (coarse + n < params_.enough_inliers) { return n; }
    n = optimize(exec, in);
    watch(step::second_inliers, from.place, n);
    if (n <= params_.narrow_above || n >= params_.enough_inliers) { return n; }
    find_held_points(exec, in.frame, state);
    int const narrow = search(exec, in, from.row, params_.narrow);
    watch(step::narrow_search, from.place, narrow);
    if (narrow + n < params_.enough_inliers) { return n; }
    n = optimize(exec, in);
    release_outliers(exec, in.frame, state);
    watch(step::third_inliers, from.place, n);
    return n;
  }

  /// Optimises the frame's pose and notes outliers, which keep their points. @return inliers
  int optimize(Exec const& exec, relocalization_input const& in) {
    memory const& m = memory_.view();
    copy(exec, m.state.held, static_cast<int const*>(in.frame.holder),
         static_cast<std::size_t>(m.state.numbers));
    optimize_frame_poses(exec, rig_, {in.frame, in.map, in.geometry},
                         {m.state.T_cw, m.state.T_cw, m.observations}, params_.pose);
    keep_outliers(exec, in.frame, m.observations, m.state);
    return read(exec, m.observations.inliers);
  }

  /// Searches a keyframe's points that are not found yet. @return keypoints taken
  int search(Exec const& exec, relocalization_input const& in, int row,
             keyframe_search_params const& params) {
    memory const& m = memory_.view();
    keyframe_search<camera_type, Rig::cameras> with;
    with.camera = detail::left_camera(rig_);
    with.T_cw = m.state.T_cw;
    with.keyframe.keypoints = in.keyframe_keypoints.slice(row * Rig::cameras);
    with.keyframe.keypoint_step = with.keyframe.cameras = Rig::cameras;
    with.keyframe.holder = in.holder + in.keyframes.groups.at(row);
    with.found = m.state.found();
    with.frustum = params_.frustum;
    with.geometry = in.geometry;
    with.params = params;
    search_keyframe(exec, with, in.frame, in.map, m.search);
    return read(exec, m.search.work.matches);
  }

  /// A number in executor memory. Waits.
  int read(Exec const& exec, int const* from) const {
    copy(exec, staging_->number, from, 1);
    exec.wait();
    return *staging_->number;
  }

  Rig rig_{};
  relocalization_params params_;
  relocalizer_capacity capacity_;
  owner<memory, space> memory_;
  owner<staging, staging_space<Exec>> staging_;
  int count_ = 0;  ///< candidates of the last match()
};

}  // namespace FT_ABI
}  // namespace ft
