// SPDX-License-Identifier: Apache-2.0
/// @file Recognises places that an odometry has seen before, and corrects its path.
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
#include "ft/core/cuda_handles.hpp"
#include "ft/core/error.hpp"
#include "ft/core/execution.hpp"
#include "ft/core/memory.hpp"
#include "ft/kernels/loops/keep_keyframe.hpp"
#include "ft/kernels/loops/match_keyframes.hpp"
#include "ft/pipelines/detail/loop_files.hpp"
#include "ft/pipelines/detail/loop_path.hpp"
#include "ft/pipelines/detail/odometry_part.hpp"
#include "ft/pipelines/detail/odometry_stages.hpp"
#include "ft/pipelines/detail/work_beside.hpp"
#include "ft/types/loops.hpp"
#include "ft/types/poses.hpp"
#include "ft/types/tracking.hpp"

namespace ft {
inline namespace FT_ABI {
namespace detail {

/// Where the search for loops runs: on threads that are given, or on a stream.
template <typename Exec>
struct loop_executor {
  Exec const& on(host_exec const& threads) const { return threads; }
  static host_exec threads_of(Exec const& exec) { return exec; }
};
#if defined(__CUDACC__)
template <>
struct loop_executor<cuda_exec> {
  loop_executor() : exec(own.get()) { throw_on_error(cudaGetDevice(&device), "cudaGetDevice"); }
  cuda_exec const& on(host_exec const&) const {
    throw_on_error(cudaSetDevice(device), "cudaSetDevice");
    return exec;
  }
  static host_exec threads_of(cuda_exec const&) { return host_exec(1); }
  stream own;
  cuda_exec exec;
  int device = 0;
};
#endif

/// Looks for loops of the newest keyframe of a path, and corrects the path.
template <typename Exec, typename Rig>
struct loop_search {
  Rig rig;
  loop_params params;
  pose_params pose_settings;
  loop_archive_view archive;
  std::unique_ptr<loop_executor<Exec>> where = std::make_unique<loop_executor<Exec>>();
  loop_path path;  ///< in and out
  int closed = 0;  ///< loops that the last run added
  struct memory {
    int* rows = nullptr;   ///< [keyframes]
    int* votes = nullptr;  ///< [keyframes]
    loop_workspace work;
    loop_match* found = nullptr;  ///< [3 groups]
  };
  struct staging {
    int* rows = nullptr;
    int* votes = nullptr;
    loop_match* found = nullptr;
  };
  owner<memory, Exec::space> memory_;
  owner<staging, staging_space<Exec>> staging_;

  loop_search(Rig const& of, loop_params const& with, pose_params const& pose_of,
              loop_archive_view const& in)
      : rig(of), params(with), pose_settings(pose_of), archive(in) {
    int const most = 3 * params.groups;
    memory_ = owner<memory, Exec::space>([&](carver& c, memory& m) {
      c.place({archive.rows}, m.rows, m.votes);
      carve(c, m.work, most, archive.points);
      c.place({most}, m.found);
    });
    staging_ = owner<staging, staging_space<Exec>>([&](carver& c, staging& s) {
      c.place({archive.rows}, s.rows, s.votes);
      c.place({most}, s.found);
    });
    path.reserve(archive.rows, params.groups);
  }

  /// Called on a thread of its own.
  void enqueue(host_exec const& threads, int) {
    closed = 0;
    Exec const& exec = where->on(threads);
    int const candidates = vote(exec);
    if (candidates == 0) { return; }
    for (auto const& group : choose(candidates)) { close(exec, group); }
    if (closed > 0) { path.optimize(threads); }
  }

private:
  int query() const { return path.size() - 1; }

  /// Votes for the keyframes that are not among the newest. @return their number
  int vote(Exec const& exec) {
    memory const& m = memory_.view();
    staging const& s = staging_.view();
    int const n = path.size() - path.newest(params.recent);
    if (n <= 0) { return 0; }
    for (int i = 0; i < n; ++i) { s.rows[i] = path.at(i).row; }
    auto const count = static_cast<std::size_t>(n);
    copy(exec, m.rows, static_cast<int const*>(s.rows), count);
    vote_for_rows(exec, archive, {path.at(query()).row, m.rows, n}, params.votes, m.votes);
    copy(exec, s.votes, static_cast<int const*>(m.votes), count);
    exec.wait();
    return n;
  }

  /// The keyframes with most votes together with their neighbours; the first one of equals.
  std::vector<std::vector<int>> choose(int n) const {
    int const* const votes = staging_->votes;
    std::vector<int> sums(static_cast<std::size_t>(n));
    for (int i = 0; i < n; ++i) {
      if (votes[i] < params.min_votes) { continue; }
      for (int const k : neighbours(i, n)) { sums[static_cast<std::size_t>(i)] += votes[k]; }
    }
    std::vector<std::vector<int>> groups;
    while (static_cast<int>(groups.size()) < params.groups) {
      auto const most = std::max_element(sums.begin(), sums.end());
      if (*most == 0) { break; }
      int const i = static_cast<int>(most - sums.begin());
      groups.push_back(neighbours(i, n));
      for (int k = std::max(i - 2, 0); k <= std::min(i + 2, n - 1); ++k) {
        sums[static_cast<std::size_t>(k)] = 0;
      }
    }
    return groups;
  }

  /// Keyframe i of the first n and those beside it that are of its part.
  std::vector<int> neighbours(int i, int n) const {
    std::vector<int> all;
    for (int k = std::max(i - 1, 0); k <= std::min(i + 1, n - 1); ++k) {
      if (path.at(k).part == path.at(i).part) { all.push_back(k); }
    }
    return all;
  }

  /// Adds the loops to a group of keyframes that two of them agree on.
  void close(Exec const& exec, std::vector<int> const& group) {
    memory const& m = memory_.view();
    staging const& s = staging_.view();
    int const n = static_cast<int>(group.size());
    for (int i = 0; i < n; ++i) { s.rows[i] = path.at(group[static_cast<std::size_t>(i)]).row; }
    copy(exec, m.rows, static_cast<int const*>(s.rows), group.size());
    match_keyframes(exec, rig, archive, {path.at(query()).row, m.rows, n},
                    static_cast<std::uint64_t>(path.at(query()).time_ns), pose_settings, m.work,
                    m.found);
    copy(exec, s.found, static_cast<loop_match const*>(m.found), group.size());
    exec.wait();
    std::vector<path_loop> loops;
    std::vector<int> inliers;
    for (int i = 0; i < n; ++i) {
      loop_match const& found = s.found[i];
      if (found.inliers < params.min_inliers ||
          static_cast<float>(found.inliers) <
              params.min_share * static_cast<float>(found.matches)) {
        continue;
      }
      path_loop loop;
      loop.from = group[static_cast<std::size_t>(i)];
      loop.to = query();
      loop.T_from_to = found.T_query_row.inverse().orthonormalized();
      edge_information(found.information, 0.5, loop.information);  // the points are as uncertain
      bool const joins = path.at(loop.from).part != path.at(loop.to).part;
      if (joins || path.fits(loop, params, static_cast<double>(rig.baseline_length().value))) {
        loops.push_back(loop);
        inliers.push_back(found.inliers);
      }
    }
    path_loop const* const best = best_agreed(loops, inliers);
    if (best == nullptr) { return; }
    if (path.at(best->from).part == path.at(query()).part) {
      path.loops.push_back(*best);
      ++closed;
    } else {
      closed += path.join(*best);
    }
  }
  /// Of the loops that another one agrees with, that of most inliers; null if there is none.
  path_loop const* best_agreed(std::vector<path_loop> const& loops,
                               std::vector<int> const& inliers) const {
    std::size_t best = loops.size();
    for (std::size_t a = 0; a < loops.size(); ++a) {
      bool agreed = false;
      for (std::size_t b = 0; b < loops.size(); ++b) {
        agreed = agreed || (a != b && path.agree(loops[a], loops[b]));
      }
      if (agreed && (best == loops.size() || inliers[a] > inliers[best])) { best = a; }
    }
    return best < loops.size() ? &loops[best] : nullptr;
  }
};

/// Keeps keyframes, and runs the search for loops beside the frames.
template <typename Exec, typename Rig>
class odometry_loops final : public odometry_part<Exec, Rig> {
  using stages_type = odometry_stages<Exec, Rig>;
  using searched_rig = typename rig_parts<Rig>::searched_rig;
  using search_type = loop_search<Exec, searched_rig>;
  static constexpr int margin = 64;  ///< rows beyond the limit, for keyframes during a search

public:
  odometry_loops(Exec const& exec, stages_type const& stages) : params_(stages.settings.loops) {
    archive_ = owner<loop_archive_view, Exec::space>([&](carver& c, loop_archive_view& v) {
      carve(c, v, params_.keyframes + margin, params_.points);
    });
    path_.reserve(archive_->rows, params_.groups);
    forget_all();
    beside_ = std::make_unique<work_beside<host_exec, search_type>>(
        loop_executor<Exec>::threads_of(exec),
        search_type(stages.rig, params_, stages.pose_settings, archive_.view()), 1, 2);
  }

  void after_frame(Exec const& exec, stages_type const& stages) override {
    odometry_output const& out = stages.own.outputs[0];
    ++frame_;
    closed_now_ = 0;
    if (running_ && frame_ == ends_) { finish(); }
    if (out.keyframe != 0) { keep(exec, stages, out); }
    if (running_ || searched_ == path_.size()) { return; }
    if (path_.size() >= params_.keyframes) {
      path_.thin([this](int row) { free_.push_back(row); });
    }
    begin();
  }
  void rethrow() override {
    if (failure_) { std::rethrow_exception(std::exchange(failure_, nullptr)); }
  }
  void describe(int, std::int64_t, tracking& t) override {
    if (t.imu.known && of_first_part()) { path_.gravity = T_world_odom_.R * t.imu.gravity; }
    t.T_world_odom = T_world_odom_;
    if (corrected_) { t.T_world_camera = (T_world_odom_ * t.T_odom_camera).orthonormalized(); }
    t.loops_closed = closed_now_;
  }
  void reset(int) override { forget_all(); }
  void save(Exec const& exec, std::ostream& to) const override {
    save_loops(exec, archive_.view(), path_, to);
  }
  void read(std::istream* from) override {
    saved_.reset();
    if (from == nullptr) { return; }
    saved_ = std::make_unique<saved_loops<Exec>>(
        read_loops<Exec>(archive_.view(), params_.keyframes + margin / 2, path_.most_loops(),
                         keyframe_task<searched_rig>::depth_cameras, *from));
  }
  void forget(Exec const& exec, int, tracking& last) override {
    forget_all();
    if (saved_ != nullptr) { enter(exec, *std::exchange(saved_, nullptr)); }
    last.T_world_odom = T_world_odom_;
  }
  void list_placed(std::vector<placed_keyframe>& to) const override {
    for (path_keyframe const& k : path_.keyframes) {
      to.push_back({k.time_ns, k.part, k.T_odom_camera, k.T_world_camera});
    }
  }
  allocated_bytes bytes() const override {
    search_type const& s = beside_->work();
    return {archive_.bytes() + s.memory_.bytes(), s.staging_.bytes()};
  }

private:
  /// Whether the camera is where the path begins, not in a map that waits to be joined.
  bool of_first_part() const {
    return path_.size() == 0 || path_.keyframes.back().part == path_.keyframes.front().part;
  }
  void keep(Exec const& exec, stages_type const& stages, odometry_output const& out) {
    if (free_.empty()) { return; }  // cannot be: a search takes fewer frames than there is margin
    path_keyframe k;
    k.row = free_.back();
    free_.pop_back();
    k.map = out.maps;
    k.time_ns = stages.own.inputs[0].time_ns;
    k.T_odom_camera = out.T_cw.inverse();
    k.T_world_camera = (T_world_odom_ * k.T_odom_camera).orthonormalized();
    edge_information(out.information, 1.0, k.information);
    k.part = k.map;
    if (path_.size() > 0) {
      path_keyframe const& last = path_.keyframes.back();
      vec3<double> const step = (last.T_odom_camera.inverse() * k.T_odom_camera).t;
      bool const goes_on = last.map == k.map;
      k.path = last.path + (goes_on ? std::sqrt(dot(step, step)) : 0.0);
      k.part = goes_on ? last.part : k.map;
    }
    keep_keyframe(exec, stages.as_keyframe(), 0, k.row, archive_.view());
    exec.wait();
    path_.keyframes.push_back(k);
  }
  void begin() {
    beside_->work().path = path_;
    searched_ = path_.size();
    // By the number of keyframes alone, so that answers do not depend on the machine.
    ends_ = frame_ + std::min(4 + path_.size() / 64, margin / 2);
    running_ = true;
    run_ = beside_->begin();
  }
  /// The correction enters. What the search threw is kept for the next frame, before anything of
  /// that has changed; this one and the odometry go on.
  void finish() {
    running_ = false;
    try {
      beside_->finish(host_exec(1), run_);
    } catch (...) {
      failure_ = std::current_exception();
      return;
    }
    loop_path const& found = beside_->work().path;
    closed_now_ = beside_->work().closed;
    path_.joints = found.joints;
    if (closed_now_ == 0) { return; }
    path_.loops = found.loops;
    rigid<double> const T_world_odom = found.T_world_odom();
    for (int i = 0; i < path_.size(); ++i) {
      path_keyframe& k = path_.keyframes[static_cast<std::size_t>(i)];
      if (i < found.size()) {
        k.part = found.at(i).part;
        k.T_world_camera = found.at(i).T_world_camera;
      } else if (k.map == found.keyframes.back().map) {  // made since
        k.part = found.keyframes.back().part;
        k.T_world_camera = (T_world_odom * k.T_odom_camera).orthonormalized();
      }
    }
    T_world_odom_ = path_.T_world_odom();  // a map that began since stays where it is
    corrected_ = true;
  }
  /// The path and the archive of a file take the place of none.
  void enter(Exec const& exec, saved_loops<Exec> const& from) {
    copy_columns(exec, archive_.view(), from.archive.view());
    exec.wait();
    for (path_keyframe const& k : from.keyframes) {
      path_.keyframes.push_back(k);
      free_.pop_back();  // its row: they are given in ascending order
    }
    path_.loops.assign(from.loops.begin(), from.loops.end());
    path_.gravity = from.gravity;
    searched_ = path_.size();
    T_world_odom_ = path_.T_world_odom();
    corrected_ = path_.size() > 0;
  }
  void forget_all() {
    if (running_) { finish(); }
    failure_ = nullptr;
    corrected_ = false;
    path_.clear();
    free_.clear();
    for (int i = archive_->rows - 1; i >= 0; --i) { free_.push_back(i); }
    searched_ = closed_now_ = 0;
    T_world_odom_ = rigid<double>::identity();
  }

  loop_params params_;
  owner<loop_archive_view, Exec::space> archive_;
  loop_path path_;
  std::vector<int> free_;  ///< rows
  rigid<double> T_world_odom_ = rigid<double>::identity();
  long long frame_ = 0;
  long long ends_ = 0;  ///< frame with which the search in progress ends
  int run_ = 0;
  int searched_ = 0;    ///< keyframes of which loops were looked for
  int closed_now_ = 0;  ///< loops that entered with the last frame
  bool running_ = false;
  std::exception_ptr failure_;                ///< of a search
  std::unique_ptr<saved_loops<Exec>> saved_;  ///< that were read, and enter with forget()
  bool corrected_ = false;                    ///< T_world_odom_ is not the identity
  std::unique_ptr<work_beside<host_exec, search_type>> beside_;  ///< last: it uses the archive
};

template <typename Rig>
inline constexpr bool closes_loops = true;
template <typename Camera>
inline constexpr bool closes_loops<monocular_rig<Camera>> = false;

/// @throws bad_argument as loops says
template <typename Exec, typename Rig>
std::unique_ptr<odometry_part<Exec, Rig>> make_part(
    loops const&, [[maybe_unused]] Exec const& exec,
    [[maybe_unused]] odometry_stages<Exec, Rig>& s) {
  if constexpr (closes_loops<Rig>) {
    require(s.batch == 1, "loops are closed for one rig, not for a batch");
    return std::make_unique<odometry_loops<Exec, Rig>>(exec, s);
  } else {
    throw bad_argument("ft: loops are not closed with one camera");
  }
}

}  // namespace detail
}  // namespace FT_ABI
}  // namespace ft
