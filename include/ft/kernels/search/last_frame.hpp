// SPDX-License-Identifier: Apache-2.0
/// @file Stage: search from the last frame. Source: specification section 10.
#pragma once

#include <cstddef>
#include <cstdint>
#include <type_traits>

#include "ft/cameras/stereo_rig.hpp"
#include "ft/containers/frame.hpp"
#include "ft/containers/keypoints.hpp"
#include "ft/containers/map_points.hpp"
#include "ft/core/config.hpp"
#include "ft/core/execution.hpp"
#include "ft/kernels/search/assignment.hpp"
#include "ft/kernels/search/detail/candidate_list.hpp"
#include "ft/kernels/search/detail/candidates.hpp"
#include "ft/kernels/search/detail/orientation_check.hpp"
#include "ft/kernels/search/last_frame_windows.hpp"
#include "ft/kernels/search/workspace.hpp"

namespace ft {
inline namespace FT_ABI {

namespace detail {

/// Item: a frame. Assigns its keypoints and checks orientations. With too few matches it lists
/// candidates in windows of twice the radius and starts again. Finally it stamps the matched
/// points.
template <typename Rig, bool Turns>
struct assign_last_points {
  using assignment = assign_keypoints<Turns, Rig::searches>;
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
                                 search_buffers const& buffers) const {
    search_params const params = search.matching();
    frame_search const in{b, frame, map, params, buffers, true, Rig::searches};
    // Prefetched; used after the proposals.
    int const left_count = search.last.keypoints.count[search.last.keypoint_step * b];
    stamp_writer const stamp(search.stamps, b / Rig::searches, map.capacity);
    bool prepared = true;
    for (int least = search.params.retry_below;; least = 0) {
      // Visible after the first barrier of the assignment.
      for (int i = g.rank(); i < rotations::bins; i += g.size()) { s.orientation.histogram[i] = 0; }
      bool enough = false;
      auto const write = [&](auto single, int const* owners) {
        if constexpr (Turns) {
          owned_keypoints const owned{search, in, left_count, owners};
          enough = write_owned<decltype(single)::value>(g, s, owned, least, stamp);
        }
        return Turns;
      };
      if (!assignment::assign(g, s.assigned, in, prepared, write)) {
        g.sync();
        enough = check_matches(g, s, search, in, least, stamp);
      }
      if (enough) { return; }
      g.sync();
      list_wider(g, s, search, in);
      g.sync();
      prepared = false;
    }
  }

private:
  /// Marks map points as matched in the current frame.
  struct stamp_writer {
    point_stamps const& stamps;
    int b;
    int slots;  ///< capacity of the map
    int now;    ///< number of the current frame

    FT_HOST_DEVICE stamp_writer(point_stamps const& of, int entry, int capacity)
        : stamps(of), b(entry), slots(capacity), now(of.seen != nullptr ? of.frame[entry] : 0) {}
    FT_HOST_DEVICE void operator()(int slot) const {
      if (stamps.seen != nullptr) {
        stamps.seen[static_cast<std::ptrdiff_t>(b) * slots + slot] = now;
      }
    }
  };

  /// The result of the proposals.
  struct owned_keypoints {
    last_search<Rig> const& search;
    frame_search const& in;
    int left_count;     ///< as in rotations::last_angle()
    int const* owners;  ///< as in assign_keypoints::assign()

    FT_HOST_DEVICE bool has_owner(int number) const { return owners[number] != unset; }
    FT_HOST_DEVICE int window(int number) const {
      return owners[number] / search_workspace::list_size;
    }
  };

  /// Writes the matches that pass the orientation check.
  /// @return false, with nothing written, if fewer than `least` pass
  template <bool Single, typename Group>
  FT_HOST_DEVICE static bool write_owned(Group g, scratch& s, owned_keypoints const& owned,
                                         int least, stamp_writer const& stamp) {
    frame_search const& in = owned.in;
    search_windows_view const& windows = in.buffers.windows;
    search_workspace const& work = in.buffers.work;
    int const numbers = in.frame.numbers();
    int const capacity = in.frame.capacity();
    bool const any = windows.count[in.b] > 0;
    int* const slots = s.assigned.before;  // of the owners' map points
    int* const histogram = s.orientation.histogram;
    struct owner {
      int slot;
      float before, now;  // angles
    };
    auto const camera_of = [&](int number) { return Single || number < capacity ? 0 : 1; };
    // Keypoints without an owner load from window 0, so that the loads need no branch.
    load_ahead<2>(
        g, any ? numbers : 0,
        [&](int number) {
          int const c = camera_of(number);
          int const i = owned.has_owner(number) ? owned.window(number) : 0;
          owner o;
          o.slot = windows.at(c, in.b, i).slot;
          o.before = rotations::last_angle(owned.search.last, owned.left_count, in.b, i);
          o.now = in.frame.camera(in.b, c).angle(number - c * capacity);
          return o;
        },
        [&](int number, owner const& o) {
          if (!owned.has_owner(number)) { return; }
          // Without the check all matches share one bin.
          bool const checks = owned.search.params.orientation_check;
          int const r = checks ? rotations::bin(o.before, o.now) : 0;
          s.orientation.bin[number] = static_cast<std::uint8_t>(r);
          atomic_add(histogram + r, 1);
          slots[number] = o.slot;
        });
    g.sync();
    auto const most = rotations::of(g.part(), histogram);
    if (most.matches < least) { return false; }
    for (int number = g.rank(); number < numbers; number += g.size()) {
      bool const stays = owned.has_owner(number) && most.has(s.orientation.bin[number]);
      int const slot = stays ? slots[number] : -1;
      in.holder()[number] = slot;
      if (!stays) { continue; }
      int const c = camera_of(number);
      work.match[work.window(c, in.b, owned.window(number))] = number - c * capacity;
      stamp(slot);
    }
    if (g.rank() == 0) { work.matches[in.b] = most.matches; }
    return true;
  }

  /// Drops matches by their orientation. Stamps the others if there are enough.
  /// @return whether there are at least `least`
  template <typename Group>
  FT_HOST_DEVICE static bool check_matches(Group g, scratch& s, last_search<Rig> const& search,
                                           frame_search const& in, int least,
                                           stamp_writer const& stamp) {
    if (search.params.orientation_check) {
      check_orientation{}(g, s.orientation, in.b, in.frame, search.last, in.buffers);
      g.sync();
    }
    bool const enough = least <= 0 || in.buffers.work.matches[in.b] >= least;
    if (enough && search.stamps.seen != nullptr) {
      int const* const holder = in.holder();
      for (int k = g.rank(); k < in.frame.numbers(); k += g.size()) {
        if (holder[k] >= 0) { stamp(holder[k]); }
      }
    }
    return enough;
  }

  /// Lists the candidates of all points in windows of twice the radius.
  template <typename Group>
  FT_HOST_DEVICE static void list_wider(Group g, scratch& s, last_search<Rig> const& search,
                                        frame_search const& in) {
    using windows_of = last_frame_windows<Rig>;
    search_windows_view const& windows = in.buffers.windows;
    frame_search listing = in;
    listing.compares_columns = windows_of::lists_by_column;
    auto const part = g.part();
    for (int i = g.part_index(); i < windows.count[in.b]; i += g.parts()) {
      window_pair const pair =
          windows_of::project(search, in.map, in.b, i, 2 * search.params.window_radius);
      if (part.rank() == 0) { store<windows_of::cameras>(windows, in.b, i, pair); }
      list_candidates::list(part, s.lists[g.part_index()], listing, i, pair);
    }
  }
};

}  // namespace detail

/// First step of search_last_frame(): windows and candidates. Needs no stereo matches of the frame.
/// Asynchronous on `exec`; allocates nothing; one launch.
template <typename Exec, typename Rig>
void list_last_frame(Exec const& exec, last_search<Rig> const& search, frame_view const& frame,
                     map_points_view const& map, search_buffers const& buffers) {
  for_each_item<per_warp>(exec, buffers.windows.batch * buffers.windows.capacity,
                          detail::list_point<detail::last_frame_windows<Rig>>{}, search, frame, map,
                          buffers);
}

/// Second step: assignment and orientation check, repeated with twice the radius if there are too
/// few matches. Writes `frame.holder`, `work.match`, `work.matches` and the stamps. Asynchronous on
/// `exec`; allocates nothing; one launch.
template <typename Exec, typename Rig>
void assign_last_frame(Exec const& exec, last_search<Rig> const& search, frame_view const& frame,
                       map_points_view const& map, search_buffers const& buffers) {
  for_each_item<per_block<detail::assign_threads>>(
      exec, frame.batch, detail::assign_last_points<Rig, Exec::asynchronous>{}, search, frame, map,
      buffers);
}

/// Search from the last frame: list_last_frame(), then assign_last_frame(). Ignores the frame's
/// previous holders. Asynchronous on `exec`; allocates nothing; two launches, of which only the
/// first is concurrent with its predecessor if `exec` says so.
template <typename Exec, typename Rig>
void search_last_frame(Exec const& exec, last_search<Rig> const& search, frame_view const& frame,
                       map_points_view const& map, search_buffers const& buffers) {
  list_last_frame(exec, search, frame, map, buffers);
  assign_last_frame(detail::with_order(exec, detail::launch_order::serial), search, frame, map,
                    buffers);
}

}  // namespace FT_ABI
}  // namespace ft
