// SPDX-License-Identifier: Apache-2.0
/// @file What loops do with keyframes of any rig: keep them, and run the search beside the frames.
#pragma once

#include <algorithm>
#include <cmath>
#include <cstddef>
#include <cstdint>
#include <exception>
#include <istream>
#include <memory>
#include <ostream>
#include <utility>
#include <vector>

#include "ft/containers/loop_archive.hpp"
#include "ft/core/config.hpp"
#include "ft/core/error.hpp"
#include "ft/core/execution.hpp"
#include "ft/core/memory.hpp"
#include "ft/pipelines/detail/loop_correction.hpp"
#include "ft/pipelines/detail/loop_files.hpp"
#include "ft/pipelines/detail/loop_frames.hpp"
#include "ft/pipelines/detail/loop_localizer.hpp"
#include "ft/pipelines/detail/loop_path.hpp"
#include "ft/pipelines/detail/loop_search.hpp"
#include "ft/pipelines/detail/odometry_files.hpp"
#include "ft/pipelines/detail/work_beside.hpp"
#include "ft/types/loops.hpp"
#include "ft/types/odometry_params.hpp"
#include "ft/types/poses.hpp"
#include "ft/types/tracking.hpp"

namespace ft {
inline namespace FT_ABI {
namespace detail {

/// Keeps keyframes, and runs the search for loops beside the frames. Compiled once for all rigs.
/// Its functions are those of odometry_part, for one camera pair.
template <typename Exec>
class loop_closing {
  using search_type = loop_search<Exec>;
  static constexpr int most_sought = 30;

public:
  /// @param archive of archive_for() @param search in it
  loop_closing(Exec const& exec, looped_odometry<Exec> of, loop_archive_view const& archive,
               std::unique_ptr<loop_localizer<Exec>> localizer, search_type search)
      : of_(std::move(of)),
        params_(of_.params),
        rules_(of_.rules),
        archive_(archive),
        awaits_scale_(of_.one_camera && of_.has_imu),
        localizer_(std::move(localizer)) {
    path_.scaled = of_.one_camera && !awaits_scale_;
    path_.reserve(archive_.rows, params_.groups + search_type::more_to_join);
    forget_all();
    beside_ = std::make_unique<work_beside<host_exec, search_type>>(
        loop_executor<Exec>::threads_of(exec), std::move(search), 1, 2);
  }
  static owner<loop_archive_view, Exec::space> archive_for(loop_params const& params) {
    return owner<loop_archive_view, Exec::space>([&](carver& c, loop_archive_view& v) {
      carve(c, v, params.keyframes + margin(params), params.points);
    });
  }

  void before_frame() {
    of_.input->looked_up = loaded_ && (rules_.localize_only || looking_) && !was_there_ ? 1 : 0;
  }
  void after_frame(Exec const& exec) {
    odometry_output const& out = *of_.output;
    ++frame_;
    closed_now_ = 0;
    if (rules_.localize_only && loaded_) { localize(exec); }
    if (looking_) { find_in_loaded(exec); }
    if (out.state != tracking_state::recovering) {
      was_there_ = out.state == tracking_state::tracking;
    }
    if (rules_.localize_only) { return; }
    map_ = out.maps;
    if (running_ && frame_ == ends_) { go_on(); }
    bool const kept = out.keyframe != 0 || (seeks() && out.state == tracking_state::tracking);
    if (kept && (!awaits_scale_ || out.maps == metric_map_)) { keep(exec, out); }
    if (running_ || (searched_ == path_.size() && !(path_.damping > 0))) { return; }
    begin();
  }
  void rethrow() {
    if (failure_) { std::rethrow_exception(std::exchange(failure_, nullptr)); }
  }
  void describe(tracking& t) {
    if (t.metric) { metric_map_ = t.maps; }
    if (t.imu.known && !rules_.localize_only && of_first_part() && of_path(t.maps)) {
      path_.gravity = T_world_odom_.R * t.imu.gravity;
    }
    tell_correction(t);
    if (corrected_) { t.T_world_camera = without_scale(in_world(t.T_odom_camera)); }
    if (t.map_id > 0 && path_.size() > 0 && of_path(t.map_id)) {
      t.map_id = path_.keyframes.back().part;
    }
    t.loops_closed = closed_now_;
  }
  void reset() { forget_all(); }
  odometry_map_view const* loaded_map() const {
    return rules_.localize_only && loaded_ ? &localizer_->loaded() : nullptr;
  }
  map_snapshot::writer save(Exec const& exec) const {
    require(!awaits_scale_ || of_path(map_),
            "the map is not saved: its scale is not known yet, and the places before it have one");
    return loop_writer(exec, archive_, path_);
  }
  void read(std::istream* from) {
    saved_.reset();
    if (from == nullptr) { return; }
    auto saved = std::make_unique<saved_loops<staging_space<Exec>>>(read_loops<Exec>(
        archive_,
        {params_.keyframes + margin() / 2, path_.most_loops(), of_.depth_cameras, path_.scaled},
        *from));
    // An IMU that has told the scale has told gravity, too.
    if (awaits_scale_ && !saved->keyframes.empty() && !(dot(saved->gravity, saved->gravity) > 0)) {
      throw error(
          "ft: the map file has no gravity: it was made without an IMU, its scale is not known");
    }
    saved_ = std::move(saved);
  }
  void forget(Exec const& exec, tracking& last) {
    forget_all();
    if (saved_ != nullptr) { enter(exec, *std::exchange(saved_, nullptr)); }
    last.metric = last.metric || metric_map_ > 0;
    tell_correction(last);
  }
  void list_placed(std::vector<placed_keyframe>& to) const { path_.list(to); }
  void list_closed(std::vector<closed_loop>& to) const { path_.list(to); }
  allocated_bytes bytes() const {
    search_type const& s = beside_->work();
    return allocated_bytes{s.memory_.bytes(), s.staging_.bytes()} + localizer_->bytes();
  }

private:
  /// Frames that a search takes: by the number of keyframes alone, so that answers do not depend on
  /// the machine. A correction takes those of its slice, too.
  static int frames_of_search(int keyframes) { return 4 + keyframes / 64; }
  /// Rows beyond the limit, for keyframes during a search and a correction. If that takes longer
  /// and they run out, a frame waits.
  static int margin(loop_params const& params) {
    return std::max(64, 2 * frames_of_search(params.keyframes));
  }
  int margin() const { return margin(params_); }
  /// Whether the camera is where the path begins, not in a map that waits to be joined.
  bool of_first_part() const {
    return path_.size() == 0 || path_.keyframes.back().part == path_.keyframes.front().part;
  }
  /// Whether keyframes of this map are kept: those of one camera with an IMU are once it has a
  /// scale.
  bool of_path(int map) const { return path_.size() == 0 || path_.keyframes.back().map == map; }
  /// Whether the camera is in a map that it began because it was not found in a loaded one, which
  /// has number 1: then each frame is looked for, of the first ones.
  bool seeks() const {
    return loaded_ && !running_ && path_.keyframes.back().part > 1 &&
           path_.newest(most_sought) < most_sought;
  }
  void keep(Exec const& exec, odometry_output const& out) {
    if (free_.empty()) { make_room(); }
    path_keyframe k;
    k.row = free_.back();
    free_.pop_back();
    k.map = out.maps;
    k.time_ns = of_.input->time_ns;
    k.T_odom_camera = out.T_cw.inverse();
    k.T_world_camera = in_world(k.T_odom_camera);
    edge_information(out.information, 1.0, k.information);
    k.part = k.map;
    if (path_.size() > 0) {
      path_keyframe const& last = path_.keyframes.back();
      vec3<double> const step = (last.T_odom_camera.inverse() * k.T_odom_camera).t;
      bool const goes_on = last.map == k.map;
      k.step = goes_on ? std::sqrt(dot(step, step)) : 0.0;
      k.part = goes_on ? last.part : k.map;
    }
    bool const follows = path_.beside + 1 == path_.size() && k.step > 0;
    if (path_.beside >= 0 && !follows) {
      path_.tie(std::min(out.inliers, params_.points), k);
      ++closed_now_;
      searched_path_differs_ = true;
    }
    path_.beside = -1;
    of_.keep(exec, k.row, true);
    exec.wait();
    path_.keyframes.push_back(k);
  }
  /// A camera that was not found is placed where a pose is given, else where a place is recognised;
  /// one that is tracked gets another part of the map where it leaves its own.
  void localize(Exec const& exec) {
    odometry_output const& out = *of_.output;
    if (out.state == tracking_state::tracking) {
      stay_beside(out);
      auto const T_world_camera = in_world(out.T_cw.inverse());
      if (localizer_->leaves(T_world_camera) &&
          localizer_->place(exec, path_, T_world_camera, T_world_odom_, rules_.first_wide_search)) {
        stay_beside(out);
      }
    } else if (find(exec)) {
      stay_beside(out);
    }
  }
  /// @return whether the frame is tracked now
  bool find(Exec const& exec) {
    odometry_input const& in = *of_.input;
    auto const place = [&](similarity<double> const& T_world_camera, bool roughly = false) {
      float const wide = roughly ? rules_.later_wide_search : rules_.first_wide_search;
      return localizer_->place(exec, path_, T_world_camera, T_world_odom_, wide);
    };
    if (in.predicted != 0 && place(in_world(in.T_cw.inverse()))) { return true; }
    int const row = archive_.rows - 1;  // of the margin
    of_.keep(exec, row, false);
    search_type& search = beside_->work();
    auto const found = search.look_up(exec, path_.size(), row, in.time_ns);
    if (found.has_value()) {
      return place(path_.at(found->from).T_world_camera * found->T_from_to);
    }
    // Where it was, or the map ends: the frame itself was not searched for there.
    if (search.looks_like != 0 || in.looked_up == 0) { return false; }
    auto const T_cw = localizer_->proposed(exec);
    return place(in_world(T_cw.value_or(of_.output->T_cw).inverse()), !T_cw.has_value());
  }
  /// A camera is looked up in each frame after a map was loaded until there is a keyframe, and the
  /// map goes on there, or a new one that is joined with it.
  void find_in_loaded(Exec const& exec) {
    odometry_output const& out = *of_.output;
    if (out.state == tracking_state::tracking) {
      stay_beside(out);
    } else if (find(exec)) {
      path_.beside = localizer_->nearest();
      if (out.begins_map == 0) {
        localizer_->order(exec, out.T_cw.inverse());
        stay_beside(out);
      }
    }
    looking_ = out.keyframe == 0;
    if (!looking_) { localizer_->forget(); }
  }
  /// In the loaded map the correction is that of the place: the odometry has drifted since.
  void stay_beside(odometry_output const& out) {
    int const k = loaded_ && out.maps == 1 ? localizer_->beside(out.T_cw.inverse()) : -1;
    path_.beside = k;
    if (k >= 0) { T_world_odom_ = localizer_->correction(k); }
  }
  /// All of the margin is used: what runs is waited for.
  void make_room() {
    if (running_) { finish(); }
    thin();
  }
  void thin() {
    int const before = path_.size();
    path_.thin([this](int row) { free_.push_back(row); });
    searched_ = std::max(searched_ - (before - path_.size()), 0);
    searched_path_differs_ = true;
  }
  similarity<double> in_world(rigid<double> const& T_odom_camera) const {
    return (T_world_odom_ * with_scale(T_odom_camera)).orthonormalized();
  }
  void tell_correction(tracking& to) const {
    to.T_world_odom = without_scale(T_world_odom_);
    to.odom_scale = T_world_odom_.scale;
  }
  /// The search has all of the path but what is new: a copy of a long path would be seen in the
  /// time of a frame.
  void begin() {
    if (path_.size() >= params_.keyframes) { thin(); }
    loop_path& to = beside_->work().path;
    if (searched_path_differs_) {
      to = path_;
      searched_path_differs_ = false;
    } else {
      to.keyframes.insert(to.keyframes.end(), path_.keyframes.begin() + to.size(),
                          path_.keyframes.end());
      to.gravity = path_.gravity;
    }
    bool const seeking = seeks();
    beside_->work().joins_only = seeking;
    beside_->work().searches = searched_ < path_.size();
    ends_ = frame_ + (seeking || searched_ == path_.size() ? 1 : frames_of_search(path_.size()));
    searched_ = path_.size();
    running_ = true;
    corrects_ = false;
    run_ = beside_->begin();  // the search
    beside_->begin();         // the correction by what it finds
  }
  /// The search ends, or the correction. What they threw is kept for the next frame, before
  /// anything of that has changed; this one and the odometry go on.
  void go_on() {
    if (!corrects_ && wait_for(run_)) {
      corrects_ = true;
      ends_ = frame_ + beside_->work().slice.frames;
    }
    if (running_ && frame_ == ends_) { finish(); }
  }
  /// @return whether it threw nothing; else nothing runs any more
  bool wait_for(int run) {
    try {
      beside_->finish(host_exec(1), run);
      return true;
    } catch (...) { failure_ = std::current_exception(); }
    beside_->drain();
    searched_path_differs_ = true;
    path_.damping = 0;
    running_ = false;
    return false;
  }
  /// The correction enters.
  void finish() {
    if (!wait_for(run_ + 1)) { return; }
    running_ = false;
    search_type& search = beside_->work();
    closed_now_ = search.closed;
    path_.joints = search.path.joints;
    path_.damping = search.path.damping;
    if (!search.enters) { return; }
    path_.loops.swap(search.corrected.loops);
    path_.keyframes.swap(search.corrected.keyframes);
    auto const& before = search.corrected.keyframes;
    path_keyframe const last = path_.keyframes.back();
    auto const T_world_odom = path_.T_world_odom();
    for (auto i = path_.keyframes.size(); i < before.size(); ++i) {  // made since
      path_keyframe k = before[i];
      if (k.map == last.map) {
        k.part = last.part;
        k.T_world_camera = (T_world_odom * with_scale(k.T_odom_camera)).orthonormalized();
      }
      path_.keyframes.push_back(k);
    }
    T_world_odom_ = path_.T_world_odom();  // a map that began since stays where it is
    corrected_ = true;
  }
  /// The path and the archive of a file take the place of none.
  void enter(Exec const& exec, saved_loops<staging_space<Exec>> const& from) {
    copy_columns(exec, archive_, from.archive.view());
    exec.wait();
    for (path_keyframe const& k : from.keyframes) {
      path_.keyframes.push_back(k);
      path_.keyframes.back().loaded = true;
      free_.pop_back();  // its row: they are given in ascending order
    }
    path_.loops.assign(from.loops.begin(), from.loops.end());
    path_.gravity = from.gravity;
    searched_ = path_.size();
    searched_path_differs_ = true;
    T_world_odom_ = path_.T_world_odom();
    corrected_ = loaded_ = path_.size() > 0;
    looking_ = loaded_ && !rules_.localize_only;
    if (awaits_scale_ && loaded_) { metric_map_ = path_.keyframes.back().map; }
    if (loaded_) {
      localizer_->load(exec, path_, from.archive.view());
      beside_->work().path = path_;
    }
  }
  void forget_all() {
    if (running_) { finish(); }
    failure_ = nullptr;
    corrected_ = loaded_ = looking_ = was_there_ = false;
    path_.clear();
    free_.clear();
    for (int i = archive_.rows - 1; i >= 0; --i) { free_.push_back(i); }
    searched_ = closed_now_ = metric_map_ = 0;
    searched_path_differs_ = true;
    T_world_odom_ = similarity<double>::identity();
  }

  looped_odometry<Exec> of_;
  loop_params const& params_;
  tracking_rules const& rules_;
  loop_archive_view archive_;
  loop_path path_;
  std::vector<int> free_;  ///< rows
  similarity<double> T_world_odom_ = similarity<double>::identity();
  bool awaits_scale_ = false;  ///< one camera, whose IMU tells the scale of each map
  int metric_map_ = 0;         ///< number of the last map whose scale was known
  int map_ = 0;                ///< number of the current one
  long long frame_ = 0;
  long long ends_ = 0;     ///< frame with which the search or the correction in progress ends
  int run_ = 0;            ///< number of the search
  int searched_ = 0;       ///< keyframes of which loops were looked for
  int closed_now_ = 0;     ///< loops that entered with the last frame
  bool running_ = false;   ///< a search and the correction after it
  bool corrects_ = false;  ///< the search has ended
  bool searched_path_differs_ = true;  ///< from path_, by more than that new keyframes are missing
  bool loaded_ = false;                ///< the path began with that of a file
  std::exception_ptr failure_;         ///< of a search
  std::unique_ptr<loop_localizer<Exec>> localizer_;
  bool looking_ = false;    ///< a map was loaded that goes on, and no keyframe was made since
  bool was_there_ = false;  ///< the camera was tracked in it, and not lost for long since
  std::unique_ptr<saved_loops<staging_space<Exec>>>
      saved_;               ///< that were read, and enter with forget()
  bool corrected_ = false;  ///< T_world_odom_ is not the identity
  std::unique_ptr<work_beside<host_exec, search_type>> beside_;  ///< last: it uses the archive
};

}  // namespace detail
}  // namespace FT_ABI
}  // namespace ft
