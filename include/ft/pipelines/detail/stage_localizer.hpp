// SPDX-License-Identifier: Apache-2.0
/// @file The stages of an odometry that a loop_localizer launches.
#pragma once

#include <cstdint>

#include "ft/containers/loop_archive.hpp"
#include "ft/core/config.hpp"
#include "ft/kernels/loops/page_keyframes.hpp"
#include "ft/kernels/odometry/recovery_evidence.hpp"
#include "ft/kernels/odometry/settle_lost.hpp"
#include "ft/kernels/search/workspace.hpp"
#include "ft/pipelines/detail/loop_localizer.hpp"
#include "ft/pipelines/detail/odometry_stages.hpp"

namespace ft {
inline namespace FT_ABI {
namespace detail {

/// Of one rig.
template <typename Exec, typename Rig>
class stage_localizer final : public loop_localizer<Exec> {
  using base = loop_localizer<Exec>;
  using stages_type = odometry_stages<Exec, Rig>;

public:
  stage_localizer(stages_type const& stages, loop_archive_view const& archive)
      : base({stages.own.map, stages.own.patches, stages.own.windowless.proposals,
              stages.memory.poses, stages.memory.observations.inliers,
              stages.own.state.radius_factor, stages.own.state.mode, stages.settings.rules,
              stages_type::starts_from_motion},
             archive),
        stages_(stages) {}

private:
  void page(Exec const& exec, paged_keyframe const* keyframes, int n) const override {
    page_keyframes(exec, stages_.rig, stages_.geometry(), this->archive_, keyframes, n,
                   stages_.own.map);
  }
  void search_local_map(Exec const& exec, int const* votes) const override {
    stages_.forget_stamps(exec);
    clear_holders(exec, stages_.memory.frame);
    stages_.choose_local(exec, votes);
    stages_.list_local_map(exec);
    stages_.assign_local_map(exec);
    if (stages_.aligns()) { stages_.align_matches(exec); }
    stages_.optimize_local(exec);
  }
  void weigh(Exec const& exec, std::int64_t* evidence) const override {
    weigh_recoveries(exec, stages_.local_input(), stages_.params.local_points, stages_.memory.frame,
                     stages_.memory.map, stages_.memory.observations.inliers, evidence);
  }
  void settle(Exec const& exec, typename base::decision const& by) const override {
    looked_up_frames in;
    in.frame = stages_.memory.frame;
    in.begins_maps = false;
    in.outcome = by.outcome;
    in.found_T_cw = in.T_cw = stages_.memory.poses;
    in.found_inliers = in.inliers = stages_.memory.observations.inliers;
    in.found_evidence = by.evidence;
    in.matches = stages_.memory.local_work.matches;
    in.matched = stages_.own.matched;
    in.begins = by.begins;
    tracking_rules const& rules = stages_.settings.rules;
    settle_lost_frames(exec, rules, in, stages_.own.state);
    if constexpr (!stages_type::starts_from_motion) {
      if (!rules.localize_only) { stages_.insert(exec, by.begins); }
    }
    stages_.keep_counts(exec);
    stages_.pack_matches(exec, stages_.outcome_of_local());
    stages_.pack_outputs(exec, nullptr);
    exec.wait();
  }

  stages_type const& stages_;
};

}  // namespace detail
}  // namespace FT_ABI
}  // namespace ft
