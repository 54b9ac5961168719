// SPDX-License-Identifier: Apache-2.0
/// @file Recognises places that an odometry has seen before, and corrects its path.
#pragma once

#include <cstdint>
#include <istream>
#include <memory>
#include <vector>

#include "ft/containers/loop_archive.hpp"
#include "ft/core/config.hpp"
#include "ft/core/error.hpp"
#include "ft/core/memory.hpp"
#include "ft/kernels/loops/keep_keyframe.hpp"
#include "ft/pipelines/detail/loop_closing.hpp"
#include "ft/pipelines/detail/loop_frames.hpp"
#include "ft/pipelines/detail/loop_search.hpp"
#include "ft/pipelines/detail/odometry_part.hpp"
#include "ft/pipelines/detail/odometry_stages.hpp"
#include "ft/pipelines/detail/stage_localizer.hpp"
#include "ft/types/loops.hpp"
#include "ft/types/tracking.hpp"

namespace ft {
inline namespace FT_ABI {
namespace detail {

/// The stages of a rig for a loop_closing.
template <typename Exec, typename Rig>
class odometry_loops final : public odometry_part<Exec, Rig> {
  using stages_type = odometry_stages<Exec, Rig>;
  using searched_rig = typename rig_parts<Rig>::searched_rig;

public:
  odometry_loops(Exec const& exec, stages_type const& stages)
      : archive_(loop_closing<Exec>::archive_for(stages.settings.loops)),
        closing_(exec, as_looped(stages), archive_.view(),
                 std::make_unique<stage_localizer<Exec, Rig>>(stages, archive_.view()),
                 loop_search<Exec>::of(stages.rig, stages.settings.loops, stages.pose_settings,
                                       archive_.view())) {}

  void before_frame(int, bool, std::int64_t, std::int64_t) override { closing_.before_frame(); }
  void after_frame(Exec const& exec, stages_type const&) override { closing_.after_frame(exec); }
  void rethrow() override { closing_.rethrow(); }
  void describe(int, std::int64_t, tracking& t) override { closing_.describe(t); }
  void reset(int) override { closing_.reset(); }
  odometry_map_view const* loaded_map() const override { return closing_.loaded_map(); }
  map_snapshot::writer save(Exec const& exec) const override { return closing_.save(exec); }
  void read(std::istream* from) override { closing_.read(from); }
  void forget(Exec const& exec, int, tracking& last) override { closing_.forget(exec, last); }
  void list_placed(std::vector<placed_keyframe>& to) const override { closing_.list_placed(to); }
  void list_closed(std::vector<closed_loop>& to) const override { closing_.list_closed(to); }
  allocated_bytes bytes() const override {
    return allocated_bytes{archive_.bytes(), 0} + closing_.bytes();
  }

private:
  looped_odometry<Exec> as_looped(stages_type const& stages) const {
    auto const keep = [this, &stages](Exec const& exec, int row, bool with_depths) {
      keep_keyframe(exec, frame_with_points(exec, stages, with_depths), 0, row, archive_.view());
    };
    return {stages.settings.loops,
            stages.settings.rules,
            stages.own.inputs,
            stages.own.outputs,
            stages_type::starts_from_motion,
            stages.settings.imu.present,
            keyframe_task<searched_rig>::depth_cameras,
            keep};
  }

  owner<loop_archive_view, Exec::space> archive_;
  loop_closing<Exec> closing_;  ///< last: it uses the archive
};

/// @throws bad_argument as loops says
template <typename Exec, typename Rig>
std::unique_ptr<odometry_part<Exec, Rig>> make_part(loops const&, Exec const& exec,
                                                    odometry_stages<Exec, Rig>& s) {
  require(s.batch == 1, "loops are closed for one rig, not for a batch");
  return std::make_unique<odometry_loops<Exec, Rig>>(exec, s);
}

}  // namespace detail
}  // namespace FT_ABI
}  // namespace ft
