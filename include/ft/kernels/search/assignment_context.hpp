// SPDX-License-Identifier: Apache-2.0
/// @file What all forms of the assignment work on.
#pragma once

#include <cstddef>
#include <cstdint>

#include "ft/containers/frame.hpp"
#include "ft/containers/map_points.hpp"
#include "ft/core/config.hpp"
#include "ft/kernels/search/candidate_list.hpp"
#include "ft/kernels/search/windows.hpp"
#include "ft/kernels/search/workspace.hpp"

namespace ft {
inline namespace FT_ABI {

namespace detail {

/// State of an assignment in block scratch.
struct assign_scratch {
  static constexpr int size = 3072;
  int open[size];
  int writer[size];
  int before[size];
  std::uint8_t held[size];
  int first_changed[3];  ///< of this turn, the one before and the next, which is cleared
  int open_count;        ///< points in `open`, where they come in any order
  int list_ended;        ///< 1 = somebody may want what the lists do not hold
  int guests;            ///< 1 = somebody looks for a point without observations
};

inline constexpr int nobody = 0x7fffffff;

template <bool Single>
struct assignment_context {
  int b;
  frame_view const& frame;
  map_points_view points;
  search_windows_view const& windows;
  search_params const& params;
  search_workspace const& work;
  int* holder;
  int const* partner;    ///< null where partners do not count
  float const* right_x;  ///< null where the lists have looked at it

  FT_HOST_DEVICE int cameras() const { return Single ? 1 : frame.cameras; }
  FT_HOST_DEVICE int numbers() const { return cameras() * frame.capacity(); }
  FT_HOST_DEVICE bool partners() const { return !Single && partner != nullptr; }
  FT_HOST_DEVICE int camera_of(int number) const {
    return Single || number < frame.capacity() ? 0 : 1;
  }
  FT_HOST_DEVICE int number(int camera, int k) const {
    return Single ? k : camera * frame.capacity() + k;
  }
  FT_HOST_DEVICE int slot(int camera, int i) const { return windows.at(camera, b, i).slot; }
  FT_HOST_DEVICE bool observed(int slot) const {
    return slot >= 0 && get<field::observations>(points, slot) > 0;
  }
  /// Whether an observed point holds a keypoint since before the search: nothing of that is
  /// listed.
  FT_HOST_DEVICE bool held(int number) const {
    return !params.from_empty && observed(holder[number]);
  }
  /// As in search_workspace.
  FT_HOST_DEVICE int list_count(int camera, int i) const {
    return work.list_count[work.window(camera, b, i)];
  }
  FT_HOST_DEVICE candidate_quad const* list(int camera, int i) const {
    return work.list + work.window(camera, b, i) * (search_workspace::list_size / 4);
  }
  FT_HOST_DEVICE int& match(int camera, int i) const {
    return work.match[work.window(camera, b, i)];
  }
  /// Whether keypoint k, which is in window i's list, does not fit for its column on the right.
  FT_HOST_DEVICE bool misses_right(int camera, int i, int k) const {
    return right_x != nullptr && camera == 0 &&
           detail::misses_right(windows.at(0, b, i), right_x[k]);
  }
  /// -1 = none
  FT_HOST_DEVICE int partner_of(int number) const { return partners() ? partner[number] : -1; }
};

/// Of a window's count. @param all candidates that were left out of the list are some
FT_HOST_DEVICE inline bool has_candidates(int count, bool all) {
  constexpr int some = search_workspace::counted | search_workspace::unlisted;
  return (count & (some | (all ? search_workspace::left_out : 0))) != 0;
}

/// Whether block scratch has place for a table of keypoints.
FT_HOST_DEVICE inline bool in_scratch(frame_view const& frame) {
  return frame.numbers() <= assign_scratch::size;
}
/// Of a keypoint: search_workspace::list_size times the window that has it, plus its place in the
/// window's list.
template <bool Single>
FT_HOST_DEVICE int* owners(assign_scratch& s, assignment_context<Single> const& ctx) {
  return in_scratch(ctx.frame)
             ? s.writer
             : ctx.work.writer + static_cast<std::ptrdiff_t>(ctx.b) * ctx.numbers();
}
/// The other table of keypoints.
template <bool Single>
FT_HOST_DEVICE int* seconds(assign_scratch& s, assignment_context<Single> const& ctx) {
  return in_scratch(ctx.frame)
             ? s.before
             : ctx.work.before + static_cast<std::ptrdiff_t>(ctx.b) * ctx.work.links;
}
/// Nobody has or writes a keypoint yet.
template <typename Group>
FT_HOST_DEVICE void empty(Group g, assign_scratch& s, int* writer, int* before, int numbers) {
  for (int k = g.rank(); k < numbers; k += g.size()) { writer[k] = before[k] = nobody; }
  if (g.rank() == 0) {
    s.open_count = 0;
    s.list_ended = 0;
    s.guests = 0;
    s.first_changed[0] = nobody;
  }
}

}  // namespace detail
}  // namespace FT_ABI
}  // namespace ft
