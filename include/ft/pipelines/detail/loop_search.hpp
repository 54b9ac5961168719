// SPDX-License-Identifier: Apache-2.0
/// @file Looks for the loops of the newest keyframe of a path.
#pragma once

#include <algorithm>
#include <cstddef>
#include <cstdint>
#include <functional>
#include <limits>
#include <memory>
#include <optional>
#include <utility>
#include <vector>

#include "ft/cameras/monocular_rig.hpp"
#include "ft/containers/loop_archive.hpp"
#include "ft/core/config.hpp"
#include "ft/core/cuda_handles.hpp"
#include "ft/core/error.hpp"
#include "ft/core/execution.hpp"
#include "ft/core/memory.hpp"
#include "ft/kernels/loops/match_keyframes.hpp"
#include "ft/pipelines/detail/loop_correction.hpp"
#include "ft/pipelines/detail/loop_path.hpp"
#include "ft/types/loops.hpp"
#include "ft/types/poses.hpp"
#include "ft/types/relocalization.hpp"

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

/// Looks for loops of the newest keyframe of a path, and corrects the path. Each even run searches,
/// the odd one after it corrects. Compiled once for all rigs.
template <typename Exec>
struct loop_search {
  /// match_keyframes() of the rig, from the memory of the search.
  using matching = std::function<void(Exec const&, loop_search const&, loop_rows const&,
                                      std::uint64_t /*seed*/)>;
  loop_params params;
  loop_archive_view archive;
  matching match;
  bool one_camera;
  double baseline;  ///< metres; one camera has none
  std::unique_ptr<loop_executor<Exec>> where = std::make_unique<loop_executor<Exec>>();
  loop_path path;                ///< in and out
  loop_path corrected;           ///< a copy of its keyframes and loops, where `enters`
  bool searches = true;          ///< in: the newest keyframe is new
  bool joins_only = false;       ///< in: looks for keyframes of other parts alone
  bool query_has_depths = true;  ///< in: of one camera, those of the newest keyframe's keypoints
  int closed = 0;                ///< loops that the last search added
  correction_slice slice;        ///< of the correction after it; no steps: there is none
  bool enters = false;           ///< the path has changed
  int looks_like = 0;            ///< places that the last look_up() has verified
  struct memory {
    int* rows = nullptr;   ///< [keyframes]
    int* votes = nullptr;  ///< [keyframes]
    loop_workspace work;
    loop_bound* bound = nullptr;  ///< [3 groups]
    loop_match* found = nullptr;  ///< [3 groups]
  };
  struct staging {
    int* rows = nullptr;
    int* votes = nullptr;
    loop_bound* bound = nullptr;
    loop_match* found = nullptr;
  };
  owner<memory, Exec::space> memory_;
  owner<staging, staging_space<Exec>> staging_;

  template <typename Rig>
  static loop_search of(Rig const& rig, loop_params const& params, pose_params const& pose_of,
                        loop_archive_view const& archive) {
    bool const one = is_monocular_v<Rig>;
    return {params, archive,
            [rig, pose_of](Exec const& exec, loop_search const& s, loop_rows const& rows,
                           std::uint64_t seed) {
              match_keyframes(exec, rig, s.archive, rows, seed, pose_of, s.memory_->work,
                              s.memory_->found);
            },
            one, one ? 0.0 : static_cast<double>(rig.baseline_length().value)};
  }
  loop_search(loop_params const& with, loop_archive_view const& in, matching by, bool one,
              double metres)
      : params(with), archive(in), match(std::move(by)), one_camera(one), baseline(metres) {
    int const most = 3 * params.groups;
    memory_ = owner<memory, Exec::space>([&](carver& c, memory& m) {
      c.place({archive.rows}, m.rows, m.votes);
      carve(c, m.work, most, archive.points);
      c.place({most}, m.bound, m.found);
    });
    staging_ = owner<staging, staging_space<Exec>>([&](carver& c, staging& s) {
      c.place({archive.rows}, s.rows, s.votes);
      c.place({most}, s.bound, s.found);
    });
    path.reserve(archive.rows, params.groups + more_to_join);
    corrected.reserve(archive.rows, params.groups + more_to_join);
  }

  /// Groups that are verified beyond loop_params::groups where the query is of another part than
  /// the first.
  static constexpr int more_to_join = 2;

  /// Called on a thread of its own.
  void enqueue(host_exec const& threads, int run) {
    if (run % 2 == 0) {
      look(where->on(threads));
    } else if (slice.steps > 0) {
      optimize(threads, path, slice.steps);
      give();
    }
  }

  /// Where the camera of a frame is that was kept as a row, and is no keyframe of the path: what
  /// the place says that most of its keypoints agree with, if no other one looks as much like it.
  /// Waits.
  /// @param known keyframes of the path, which stays as it is
  std::optional<path_loop> look_up(Exec const& exec, int known, int row, std::int64_t time_ns) {
    path.keyframes.resize(static_cast<std::size_t>(known));
    int const part = path.keyframes.back().part;
    path_keyframe frame;
    frame.row = row;
    frame.time_ns = time_ns;
    frame.map = frame.part = path.keyframes.back().map + 1;
    path.keyframes.push_back(frame);
    joins_only = true;
    query_has_depths = !one_camera;
    std::vector<path_loop> const found = verified(exec);
    looks_like = static_cast<int>(found.size());
    std::optional<path_loop> best;
    for (path_loop const& l : found) {
      bool const is_best = !best.has_value() || l.inliers > best->inliers;
      if (path.at(l.from).part == part && is_best && is_told_apart(l, found)) { best = l; }
    }
    path.keyframes.pop_back();
    query_has_depths = true;
    return best;
  }

private:
  /// Adds loops, and says how long the correction takes. Where a map was joined that enters at
  /// once, if the correction takes longer than this.
  void look(Exec const& exec) {
    closed = 0;
    slice = {};
    enters = false;
    bool const joined = searches && search(exec);
    if (closed > 0) { path.damping = first_path_damping; }
    if (!(path.damping > 0)) { return; }
    slice = slice_of(path);
    if (joined && slice.frames > 0) {
      slice = {};
      give();
    }
  }
  void give() {
    corrected.keyframes = path.keyframes;
    corrected.loops = path.loops;
    enters = true;
  }
  /// @return whether a map was joined
  bool search(Exec const& exec) {
    std::vector<path_loop> const found = verified(exec);
    std::vector<path_loop> told_apart;  // by the path as it was: close() may move a part of it
    for (path_loop const& l : found) {
      if (is_told_apart(l, found)) { told_apart.push_back(l); }
    }
    int const part = path.at(query()).part;
    for (path_loop const& l : told_apart) { close(l); }
    return path.at(query()).part != part;
  }
  /// The loops of the places that look most like the newest keyframe's.
  std::vector<path_loop> verified(Exec const& exec) {
    std::vector<path_loop> found;
    int const candidates = vote(exec);
    if (candidates == 0) { return found; }
    for (auto const& group : choose(candidates)) { verify(exec, group, found); }
    return found;
  }
  int query() const { return path.size() - 1; }
  /// Whether the query is of a map that is not joined yet.
  bool joins() const { return path.at(query()).part != path.at(0).part; }

  /// Votes for the keyframes that are not among the newest ones of their part. @return their number
  int vote(Exec const& exec) {
    memory const& m = memory_.view();
    staging const& s = staging_.view();
    int const n = path.size() - path.newest(joins_only ? path.size() : params.recent);
    if (n <= 0) { return 0; }
    for (int i = 0; i < n; ++i) { s.rows[i] = path.at(i).row; }
    auto const count = static_cast<std::size_t>(n);
    copy(exec, m.rows, static_cast<int const*>(s.rows), count);
    vote_for_rows(exec, archive, {path.at(query()).row, m.rows, n}, params.votes, m.votes);
    copy(exec, s.votes, static_cast<int const*>(m.votes), count);
    exec.wait();
    return n;
  }

  /// The keyframes with most votes together with their neighbours, the first one of equals; then,
  /// in the part of the query, that of those with at least half as many which is nearest in a
  /// straight line, for where places look the same that is the one. Each is so many keyframes from
  /// those before that it sees another place. Of a map that is not joined yet, whose first frames
  /// may have to be found beside the keyframe of most votes, it need not be, and there are two
  /// more.
  std::vector<std::vector<int>> choose(int n) const {
    int const* const votes = staging_->votes;
    std::vector<int> sums(static_cast<std::size_t>(n));
    for (int i = 0; i < n; ++i) {
      if (votes[i] < params.min_votes) { continue; }
      for (int const k : neighbours(i, n)) { sums[static_cast<std::size_t>(i)] += votes[k]; }
    }
    std::vector<std::vector<int>> groups;
    int enough = 0;
    int const most_groups = params.groups + (joins() ? more_to_join : 0);
    int const beside = joins() ? 2 : 5;  // keyframes
    while (static_cast<int>(groups.size()) < most_groups) {
      auto const most = std::max_element(sums.begin(), sums.end());
      if (*most == 0) { break; }
      int i = static_cast<int>(most - sums.begin());
      if (groups.empty()) {
        enough = (*most + 1) / 2;
      } else {
        i = nearest(sums, enough, i);
      }
      groups.push_back(neighbours(i, n));
      for (int k = std::max(i - beside, 0); k <= std::min(i + beside, n - 1); ++k) {
        sums[static_cast<std::size_t>(k)] = 0;
      }
    }
    return groups;
  }

  /// Of the keyframes of the query's part that have enough votes the one that the path has nearest
  /// in a straight line; i if there is none.
  int nearest(std::vector<int> const& sums, int enough, int i) const {
    path_keyframe const& from = path.at(query());
    double least = std::numeric_limits<double>::infinity();
    for (int k = 0; k < static_cast<int>(sums.size()); ++k) {
      if (sums[static_cast<std::size_t>(k)] < enough || path.at(k).part != from.part) { continue; }
      auto const off = path.at(k).T_world_camera.t - from.T_world_camera.t;
      if (dot(off, off) < least) {
        least = dot(off, off);
        i = k;
      }
    }
    return i;
  }

  /// Keyframe i of the first n and those beside it that are of its part.
  std::vector<int> neighbours(int i, int n) const {
    std::vector<int> all;
    for (int k = std::max(i - 1, 0); k <= std::min(i + 1, n - 1); ++k) {
      if (path.at(k).part == path.at(i).part) { all.push_back(k); }
    }
    return all;
  }

  /// Adds the loop to a group of keyframes that two of them agree on, if there is one.
  void verify(Exec const& exec, std::vector<int> const& group, std::vector<path_loop>& to) {
    memory const& m = memory_.view();
    staging const& s = staging_.view();
    int const n = static_cast<int>(group.size());
    // Of another part nothing is known, and the units of one camera may differ by anything.
    bool const is_known = !path.scaled && path.at(group[0]).part == path.at(query()).part;
    for (int i = 0; i < n; ++i) {
      int const k = group[static_cast<std::size_t>(i)];
      s.rows[i] = path.at(k).row;
      if (is_known) { s.bound[i] = path.bound(k, query(), params, baseline); }
    }
    copy(exec, m.rows, static_cast<int const*>(s.rows), group.size());
    copy(exec, m.bound, static_cast<loop_bound const*>(s.bound), is_known ? group.size() : 0);
    match(exec, *this,
          {path.at(query()).row, m.rows, n, query_has_depths, is_known ? m.bound : nullptr},
          static_cast<std::uint64_t>(path.at(query()).time_ns));
    copy(exec, s.found, static_cast<loop_match const*>(m.found), group.size());
    exec.wait();
    std::vector<path_loop> loops;
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
      loop.inliers = found.inliers;
      loop.T_from_to = with_scale(found.T_query_row.inverse().orthonormalized());
      edge_information(found.information, 0.5, loop.information);  // the points are as uncertain
      if (path.scaled) { set_scale(found, loop); }
      bool const joins = path.at(loop.from).part != path.at(loop.to).part;
      if (joins ||
          (path.fits(loop, params, baseline) && path.tells(loop, params) && path.is_alike(loop))) {
        loops.push_back(loop);
      }
    }
    std::size_t const best = best_agreed(loops);
    if (best < loops.size()) { to.push_back(loops[best]); }
  }
  /// Whether no other place looks as much like that of a loop.
  bool is_told_apart(path_loop const& loop, std::vector<path_loop> const& all) const {
    for (path_loop const& other : all) {
      if (&other != &loop && 2 * other.inliers > loop.inliers &&
          path.contradict(loop, other, params, baseline)) {
        return false;
      }
    }
    return true;
  }
  void close(path_loop const& loop) {
    if (path.at(loop.from).part != path.at(query()).part) {
      closed += path.join(loop);
    } else if (path.fits(loop, params, baseline)) {  // also after the join by another one
      path.add(loop);
      ++closed;
    }
  }
  /// The scale of a loop, and its information in units of the keyframe that it leads to.
  static void set_scale(loop_match const& found, path_loop& loop) {
    loop.T_from_to.scale = 1 / found.scale;
    for (int i = 0, at = 0; i < 6; ++i) {
      for (int j = i; j < 6; ++j, ++at) {
        loop.information[at] *= (i < 3 ? loop.T_from_to.scale : 1.0);
        loop.information[at] *= (j < 3 ? loop.T_from_to.scale : 1.0);
      }
    }
    loop.scale_information = 0.5 / (found.scale_sigma * found.scale_sigma);
  }
  /// Of the loops that another one agrees with, that of most inliers; their number if there is
  /// none.
  std::size_t best_agreed(std::vector<path_loop> const& loops) const {
    std::size_t best = loops.size();
    for (std::size_t a = 0; a < loops.size(); ++a) {
      bool agreed = false;
      for (std::size_t b = 0; b < loops.size(); ++b) {
        agreed = agreed || (a != b && path.agree(loops[a], loops[b]));
      }
      if (agreed && (best == loops.size() || loops[a].inliers > loops[best].inliers)) { best = a; }
    }
    return best;
  }
};

}  // namespace detail
}  // namespace FT_ABI
}  // namespace ft
