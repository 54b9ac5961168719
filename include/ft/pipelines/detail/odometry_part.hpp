// SPDX-License-Identifier: Apache-2.0
/// @file What is plugged into an odometry: its say at the named points of a frame.
#pragma once

#include <cstdint>
#include <iosfwd>
#include <memory>
#include <vector>

#include "ft/containers/odometry_map.hpp"
#include "ft/containers/window_problem.hpp"
#include "ft/core/config.hpp"
#include "ft/pipelines/detail/sample_queue.hpp"
#include "ft/types/features.hpp"
#include "ft/types/loops.hpp"
#include "ft/types/tracking.hpp"

namespace ft {
inline namespace FT_ABI {
namespace detail {

template <typename Exec, typename Rig>
class odometry_stages;

/// A part of an odometry, which takes its memory in its constructor. A program that names no part
/// compiles none of its kernels. Launches are asynchronous and allocate nothing; they may be
/// recorded. Forks and joins are those of odometry_schedule.hpp.
template <typename Exec, typename Rig>
class odometry_part {
public:
  using stages_type = odometry_stages<Exec, Rig>;

  odometry_part() = default;
  odometry_part(odometry_part const&) = delete;
  odometry_part& operator=(odometry_part const&) = delete;
  virtual ~odometry_part() = default;
  virtual allocated_bytes bytes() const = 0;

  // ---- launches of a frame, in order

  virtual bool launches() const { return false; }  ///< whether there are any
  virtual void after_inputs(Exec const&, stages_type const&) const {}
  virtual void beside_adjusted_map(Exec const&, stages_type const&) const {}
  virtual void after_adjusted_map(Exec const&, stages_type const&) const {}
  virtual void after_prediction(Exec const&, stages_type const&) const {}
  virtual void after_pose(Exec const&, stages_type const&) const {}
  virtual void beside_decision(Exec const&, stages_type const&) const {}
  virtual void before_outputs(Exec const&, stages_type const&) const {}
  virtual void beside_window(Exec const&, stages_type const&) const {}
  virtual void beside_result(Exec const&, stages_type const&) const {}

  /// Instead of those of images, of a frame whose features were taken.
  virtual void queue_features(Exec const&, stages_type const&) const {}

  /// Whether the host needs nothing of what is launched after before_outputs().
  virtual bool tells_with_outputs() const { return false; }

  // ---- beside frames

  /// After an adjustment. @param selected [batch] executor memory: its cameras
  virtual void after_adjustment(Exec const&, int const* /*selected*/,
                                window_problem_view const&) const {}

  // ---- calls of the host

  /// Before anything of a frame changes. @throws what work beside the frames has thrown
  virtual void rethrow() {}
  /// Before a frame of camera pair b. @param begun whether there was a frame before it
  virtual void before_frame(int /*b*/, bool /*begun*/, std::int64_t /*from_ns*/,
                            std::int64_t /*to_ns*/) {}
  /// After a frame, and the wait for it, or for its outputs. May wait.
  virtual void after_frame(Exec const&, stages_type const&) {}
  /// What it knows about the frame of camera pair b.
  virtual void describe(int /*b*/, std::int64_t /*time_ns*/, tracking&) {}
  /// Adds the keyframes whose places it has corrected.
  virtual void list_placed(std::vector<placed_keyframe>& /*to*/) const {}
  /// Adds the loops between them.
  virtual void list_closed(std::vector<closed_loop>& /*to*/) const {}
  /// The map as it was loaded, in executor memory, if the odometry's own is a part of it now; else
  /// null.
  virtual odometry_map_view const* loaded_map() const { return nullptr; }
  /// Copies what belongs to a map and is written behind it; empty if nothing does. Waits, and
  /// allocates.
  virtual map_snapshot::writer save(Exec const&) const { return {}; }
  /// Reads and checks what that has written, or null, for the forget() that follows. Allocates.
  virtual void read(std::istream*) {}
  /// Camera pair b begins anew.
  virtual void reset(int /*b*/) {}
  /// Camera pair b got another map. May wait. @param last gets where the map's frame is, if that
  /// is not the world's, and whether its unit is known
  virtual void forget(Exec const&, int /*b*/, tracking& /*last*/) {}
  /// Takes the features of the next frame of camera pair b; false if this part takes none.
  /// @throws bad_argument
  virtual bool take_features(int /*b*/, given_features const&) { return false; }
  /// Takes the samples of camera pair b's IMU; null if this part has no IMU.
  virtual sample_queue* samples(int /*b*/) { return nullptr; }
};

template <typename Exec, typename Rig>
using odometry_part_list = std::vector<std::unique_ptr<odometry_part<Exec, Rig>>>;

}  // namespace detail
}  // namespace FT_ABI
}  // namespace ft
