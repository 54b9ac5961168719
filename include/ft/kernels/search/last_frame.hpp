// SPDX-License-Identifier: Apache-2.0
/// @file Stage: search from the last frame. Source: specification section 10.
#pragma once

#include <cstddef>
#include <cstdint>
#include <type_traits>

#include "ft/cameras/stereo_rig.hpp"
#include "ft/containers/frame.hpp"
#include "ft/containers/image_pyramid.hpp"
#include "ft/containers/keypoints.hpp"
#include "ft/containers/map_points.hpp"
#include "ft/core/config.hpp"
#include "ft/core/execution.hpp"
#include "ft/kernels/search/assignment.hpp"
#include "ft/kernels/search/candidates.hpp"
#include "ft/kernels/search/last_frame_windows.hpp"
#include "ft/kernels/search/orientation_check.hpp"
#include "ft/kernels/search/windows.hpp"
#include "ft/kernels/search/workspace.hpp"

namespace ft {
inline namespace FT_ABI {

namespace detail {

/// Item: a frame. Assigns its keypoints and checks orientations. With too few matches it lists
/// candidates in windows of twice the radius and starts again. Finally it stamps the matched
/// points.
template <typename Rig, bool Turns>
struct assign_last_points {
  using assignment = assign_keypoints<Turns>;
  struct scratch {
    union {
      typename assignment::scratch assigned;
      list_candidates::scratch lists[assign_threads / 32];  ///< per warp, for the second try
    };
    check_orientation::scratch orientation;
  };

  template <typename Group, typename... Args>
  FT_HOST_DEVICE static void prologue(Group g, scratch& s, int b, last_search<Rig> const&,
                                      frame_view const& frame, Args const&...) {
    assignment::prologue(g, s.assigned, b, frame);
  }

  template <typename Group>
  FT_HOST_DEVICE void operator()(Group g, scratch& s, int b, last_search<Rig> const& search,
                                 frame_view const& frame, map_points_view const& map,
                                 pyramid_geometry const& geometry, search_params const& params,
                                 point_stamps const& stamps, search_windows_view const& windows,
                                 search_workspace const& work) const {
    // Prefetched; used after the proposals.
    int const left_count = search.last.keypoints.count[search.last.keypoint_step * b];
    int const now = stamps.seen != nullptr ? stamps.frame[b] : 0;
    auto const stamp = [&](int slot) {
      if (stamps.seen != nullptr) {
        stamps.seen[static_cast<std::ptrdiff_t>(b) * map.capacity + slot] = now;
      }
    };
    bool prepared = true;
    for (int least = search.params.retry_below;; least = 0) {
      // Visible after the first barrier of the assignment.
      for (int i = g.rank(); i < rotations::bins; i += g.size()) { s.orientation.histogram[i] = 0; }
      bool enough = false;
      auto const write = [&](auto single, int const* owners) {
        if constexpr (Turns) {
          enough = write_owned<decltype(single)::value>(g, s, b, search, left_count, frame, windows,
                                                        work, owners, least, stamp);
        }
        return Turns;
      };
      bool const written =
          assignment::assign(g, s.assigned, b, frame, map, windows, params, work, prepared, write);
      if (!written) {
        g.sync();
        if (search.params.orientation_check) {
          check_orientation{}(g, s.orientation, b, frame, search.last, windows, work);
          g.sync();
        }
        enough = least <= 0 || work.matches[b] >= least;
        if (enough && stamps.seen != nullptr) {
          int const* const holder = frame.holder + static_cast<std::ptrdiff_t>(b) * frame.numbers();
          for (int k = g.rank(); k < frame.numbers(); k += g.size()) {
            if (holder[k] >= 0) { stamp(holder[k]); }
          }
        }
      }
      if (enough) { return; }
      g.sync();
      list_wider(g, s, b, search, frame, map, geometry, params, windows, work);
      g.sync();
      prepared = false;
    }
  }

private:
  /// Writes the matches that pass the orientation check.
  /// @param left_count as in rotations::last_angle()
  /// @param owners as in assign_keypoints::assign()
  /// @return false, with nothing written, if they are fewer than `least`
  template <bool Single, typename Group, typename Stamp>
  FT_HOST_DEVICE static bool write_owned(Group g, scratch& s, int b, last_search<Rig> const& search,
                                         int left_count, frame_view const& frame,
                                         search_windows_view const& windows,
                                         search_workspace const& work, int const* owners, int least,
                                         Stamp const& stamp) {
    int const numbers = frame.numbers();
    bool const any = windows.count[b] > 0;
    int* const slots = s.assigned.before;  // of the owners' map points
    int* const histogram = s.orientation.histogram;
    struct owner {
      int slot;
      float before, now;  // angles
    };
    auto const camera_of = [&](int number) { return Single || number < frame.capacity() ? 0 : 1; };
    // Keypoints without an owner load from window 0, so that the loads need no branch.
    load_ahead<2>(
        g, any ? numbers : 0,
        [&](int number) {
          int const c = camera_of(number);
          bool const owned = owners[number] != unset;
          int const i = owned ? owners[number] / search_workspace::list_size : 0;
          owner o;
          o.slot = windows.at(c, b, i).slot;
          o.before = rotations::last_angle(search.last, left_count, b, i);
          o.now = get<field::angle>(frame.camera(b, c), number - c * frame.capacity());
          return o;
        },
        [&](int number, owner const& o) {
          if (owners[number] == unset) { return; }
          // Without the check all matches share one bin.
          int const r = search.params.orientation_check ? rotations::bin(o.before, o.now) : 0;
          s.orientation.bin[number] = static_cast<std::uint8_t>(r);
          atomic_add(histogram + r, 1);
          slots[number] = o.slot;
        });
    g.sync();
    auto const most = rotations::of(g.part(), histogram);
    if (most.matches < least) { return false; }
    for (int number = g.rank(); number < numbers; number += g.size()) {
      bool const stays = owners[number] != unset && most.has(s.orientation.bin[number]);
      int const slot = stays ? slots[number] : -1;
      frame.holder[static_cast<std::ptrdiff_t>(b) * numbers + number] = slot;
      if (!stays) { continue; }
      int const c = camera_of(number);
      work.match[work.window(c, b, owners[number] / search_workspace::list_size)] =
          number - c * frame.capacity();
      stamp(slot);
    }
    if (g.rank() == 0) { work.matches[b] = most.matches; }
    return true;
  }

  template <typename Group>
  FT_HOST_DEVICE static void list_wider(Group g, scratch& s, int b, last_search<Rig> const& search,
                                        frame_view const& frame, map_points_view const& map,
                                        pyramid_geometry const& geometry,
                                        search_params const& params,
                                        search_windows_view const& windows,
                                        search_workspace const& work) {
    int const count = windows.count[b];
    for (int i = g.part_index(); i < count; i += g.parts()) {
      list_last_point<Rig>::list(g.part(), s.lists[g.part_index()], b, i, search,
                                 2 * search.params.th, frame, map, geometry, params, windows, work);
    }
  }
};

}  // namespace detail

/// Search from the last frame: windows, candidates, assignment, orientation check. Starts from
/// empty holders. Asynchronous on `exec`; allocates nothing; two launches.
/// @param exec its launch order applies to the first of the two only
/// @param listed called as listed(exec) between the two launches; may enqueue what fills right_x
template <typename Exec, typename Rig, typename Listed>
void search_last_frame(Exec const& exec, last_search<Rig> const& input, frame_view const& frame,
                       map_points_view const& map, pyramid_geometry const& geometry,
                       search_windows_view const& windows, search_workspace const& work,
                       point_stamps const& stamps, Listed const& listed) {
  search_params search;
  search.kind = search_kind::last_frame;
  search.from_empty = true;
  search.right_later = true;
  for_each_item<per_warp>(exec, windows.batch * windows.capacity, detail::list_last_point<Rig>{},
                          input, frame, map, geometry, search, windows, work);
  listed(detail::with_order(exec, detail::launch_order::serial));
  for_each_item<per_block<detail::assign_threads>>(
      detail::with_order(exec, detail::launch_order::serial), frame.batch,
      detail::assign_last_points<Rig, Exec::asynchronous>{}, input, frame, map, geometry, search,
      stamps, windows, work);
}

/// The same for a frame whose right_x is valid before the call, and no stamps.
template <typename Exec, typename Rig>
void search_last_frame(Exec const& exec, last_search<Rig> const& input, frame_view const& frame,
                       map_points_view const& map, pyramid_geometry const& geometry,
                       search_windows_view const& windows, search_workspace const& work) {
  search_last_frame(exec, input, frame, map, geometry, windows, work, {}, [](Exec const&) {});
}

/// The same without a last_search at hand.
/// @param poses,last_poses [batch] T_cw predicted for the current frame, and of the last frame
template <typename Exec, typename Rig, typename Listed>
void search_last_frame(Exec const& exec, Rig const& rig, pose const* poses, pose const* last_poses,
                       frame_view const& frame, last_frame_view const& last,
                       map_points_view const& map, last_search_params const& params,
                       pyramid_geometry const& geometry, search_windows_view const& windows,
                       search_workspace const& work, point_stamps const& stamps,
                       Listed const& listed) {
  search_last_frame(exec, last_search<Rig>{rig, poses, last_poses, last, params}, frame, map,
                    geometry, windows, work, stamps, listed);
}

/// The same for a frame whose right_x is valid before the call.
template <typename Exec, typename Rig>
void search_last_frame(Exec const& exec, Rig const& rig, pose const* poses, pose const* last_poses,
                       frame_view const& frame, last_frame_view const& last,
                       map_points_view const& map, last_search_params const& params,
                       pyramid_geometry const& geometry, search_windows_view const& windows,
                       search_workspace const& work, point_stamps const& stamps = {}) {
  search_last_frame(exec, rig, poses, last_poses, frame, last, map, params, geometry, windows, work,
                    stamps, [](Exec const&) {});
}

}  // namespace FT_ABI
}  // namespace ft
