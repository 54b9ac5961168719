// SPDX-License-Identifier: Apache-2.0
/// @file What is computed from the images of a frame alone, and the stages that compute it.
#pragma once

#include <cstddef>
#include <utility>

#include "ft/containers/feature_grid.hpp"
#include "ft/containers/keypoints.hpp"
#include "ft/core/config.hpp"
#include "ft/core/execution.hpp"
#include "ft/core/memory.hpp"
#include "ft/core/recording.hpp"
#include "ft/pipelines/detail/extraction.hpp"
#include "ft/pipelines/detail/frame_schedule.hpp"
#include "ft/pipelines/detail/rig_parts.hpp"
#include "ft/pipelines/orb_extractor.hpp"

namespace ft {
inline namespace FT_ABI {
namespace detail {

/// Images of a batch of rigs, their keypoints, grids of these and their stereo. Move-only.
template <typename Exec, typename Rig>
struct frame_features {
  using parts_of_rig = rig_parts<Rig>;

  typename parts_of_rig::template input<Exec> input;
  orb_extractor<Exec> extractor;
  typename parts_of_rig::template matcher<Exec> matcher;
  feature_grid_view grids;
  arena<Exec::space> grid_memory;
  recording<Exec> graph;  ///< of queue()
  int number = 0;         ///< which set of features of an odometry it is

  /// @param like grids of which these are to have the size
  /// @throws bad_argument, std::bad_alloc, cuda_error
  frame_features(Exec const& exec, Rig const& rig, orb_extractor<Exec> made, int batch,
                 feature_grid_view const& like)
      : input(exec, rig, made.geometry(), batch), extractor(std::move(made)) {
    matcher = parts_of_rig::make_matcher(rig, extractor, input);
    int const images = batch * Rig::cameras;
    grid_memory = arena<Exec::space>(
        [&](carver& c) { carve(c, grids, like.geometry, like.capacity, images); });
    fill_bytes(exec, grids.start, 0,
               static_cast<std::size_t>(images) *
                   static_cast<std::size_t>(grids.geometry.cells() + 1) * sizeof(int));
  }

  allocated_bytes bytes() const {
    return input.allocated() +
           allocated_bytes{extractor.bytes() + matcher.bytes() + grid_memory.bytes(), 0};
  }

  /// Enqueues all stages, from the images that the input has taken.
  void queue(Exec const& exec) {
    stage_clock<Exec> untimed;
    stage_line<Exec> line(exec, untimed);
    using grids_type = decltype(grids_of(matcher, grids));
    if constexpr (describes_images) {
      from_input<grids_type> const from{{extractor.stages(), nullptr, grids_of(matcher, grids)},
                                        input};
      queue_images(line, from, false);
    }
    if constexpr (parts_of_rig::undistorts) {
      matcher.undistort(line.then("undistort"), extractor, grids);
    }
    matcher.match_sorted(line.then("stereo"), extractor);
    line.end();
  }

  void record(Exec const& exec) {
    graph.record(exec, [&](Exec const& e) { queue(e); });
  }
  /// The same as queue(), by the graph if one was recorded.
  void replay(Exec const& exec) {
    graph.replay(exec, [&](Exec const& e) { queue(e); });
  }

private:
  /// The stages of the extractor with the images of the input.
  template <typename Grids>
  struct from_input : extraction_with<Exec, Grids> {
    typename parts_of_rig::template input<Exec> const& input;

    void upload(Exec const& exec, bool /*with_local*/) const { input.upload(exec, this->stages); }
    bool pyramid_overlaps_upload() const {
      return input.overlaps_pyramid && this->stages.pyramid_overlaps_upload();
    }
  };
};

}  // namespace detail
}  // namespace FT_ABI
}  // namespace ft
