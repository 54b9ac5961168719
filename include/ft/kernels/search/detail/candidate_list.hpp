// SPDX-License-Identifier: Apache-2.0
/// @file Which keypoints are candidates of a window, and the sorted list of the nearest.
#pragma once

#include <cmath>
#include <cstddef>
#include <cstdint>

#include "ft/containers/frame.hpp"
#include "ft/containers/keypoints.hpp"
#include "ft/containers/map_points.hpp"
#include "ft/core/config.hpp"
#include "ft/kernels/search/workspace.hpp"

namespace ft {
inline namespace FT_ABI {

// The inputs and outputs of a search in one frame, shared by its steps.

namespace detail {

struct frame_search {
  int b;  ///< batch entry
  frame_view const& frame;
  map_points_view const& map;  ///< of all rigs
  search_params const& params;
  search_buffers const& buffers;
  /// Whether this step compares columns in the right image. Only one step of a search does: for the
  /// local map the listing, from the last frame the assignment, so that its listing needs no stereo
  /// matches.
  bool compares_columns;
  int searches = 1;  ///< of a rig, whose batch entries share a map

  /// The map's points.
  FT_HOST_DEVICE map_points_view points() const { return map.slice(b / searches); }
  /// Holders of this frame.
  FT_HOST_DEVICE int* holder() const {
    return frame.holder + static_cast<std::ptrdiff_t>(b) * frame.numbers();
  }
  /// Columns in the right image of this frame's left keypoints; null if they are not compared.
  FT_HOST_DEVICE float const* right_x() const {
    return compares_columns && frame.right_x != nullptr
               ? frame.right_x + static_cast<std::ptrdiff_t>(b) * frame.capacity()
               : nullptr;
  }
  /// Whether the stereo partner of a matched keypoint is matched, too.
  FT_HOST_DEVICE bool partners() const {
    return frame.partner != nullptr && params.kind == search_kind::local_map;
  }
};

/// Largest descriptor distance that can matter, as the best or the second best candidate.
FT_HOST_DEVICE inline int listed_distance(search_params const& p) {
  if (!(p.kind == search_kind::local_map && p.ratio > 0)) { return p.max_hamming; }
  constexpr int most = descriptor_scale::most;
  float const second =
      min_of(static_cast<float>(p.max_hamming) / p.ratio, static_cast<float>(most));
  return max_of(p.max_hamming, min_of(most, static_cast<int>(second) + 1));
}

/// Whether a keypoint's column r in the right image, -1 = none, lies outside the window.
FT_HOST_DEVICE inline bool misses_right(search_window const& w, float r) {
  return w.check_right && r > 0 && ::fabsf(w.right_x - r) > w.radius;
}

/// Descriptor distance of keypoint k, -1 if it is not a candidate. Ignores its holder.
FT_HOST_DEVICE inline int candidate_distance(search_window const& w, keypoints_view const& kp,
                                             float const* right_x, descriptor const& wanted, int k,
                                             int limit) {
  if (!inside(w, kp, k)) { return -1; }
  if (right_x != nullptr && misses_right(w, right_x[k])) { return -1; }
  int const distance = search_distance(wanted, kp.orb(k));
  return distance <= limit ? distance : -1;
}

/// Ratio test: whether the best candidate is too similar to the second best. In float, as in the
/// reference, which keeps the ratio in one.
/// @param second_k second best keypoint, -1 = none
FT_HOST_DEVICE inline bool refuses(search_params const& p, keypoints_view const& kp, int best,
                                   int best_k, int second, int second_k) {
  return p.kind == search_kind::local_map && second_k >= 0 &&
         static_cast<float>(best) > mul(p.ratio, static_cast<float>(second)) &&
         kp.octave(best_k) == kp.octave(second_k);
}

FT_HOST_DEVICE inline int entry_distance(std::uint32_t entry) {
  return static_cast<int>(entry >> 23);
}
FT_HOST_DEVICE inline int entry_keypoint(std::uint32_t entry) {
  return static_cast<int>(entry & 0x7fffffu);
}

/// The nearest candidates of a window, sorted by distance. Of equal distances the first added comes
/// first.
/// @tparam Group one thread or a warp
template <typename Group>
class candidate_list {
public:
  static constexpr int size = search_workspace::list_size;

  /// @param to scratch for `size` candidates
  /// @param found number of candidates already added to it
  FT_HOST_DEVICE explicit candidate_list(candidate_quad* to, int found = 0)
      : to_(to), found_(found) {}

  /// Adds one candidate per thread, in the order of ranks. A negative distance adds nothing.
  FT_HOST_DEVICE void add(Group g, int distance, int k) {
    unsigned const there = g.ballot(distance >= 0);
    if (there == 0) { return; }
    if constexpr (Group::max_threads == 1) {
      int place = min_of(found_, size);
      for (; place > 0 && entry_distance(entry(place - 1)) > distance; --place) {
        if (place < size) { entry(place) = entry(place - 1); }
      }
      if (place < size) { entry(place) = packed(distance, k); }
      ++found_;
    } else {
      // Few enough to rank by counting: the place of each is the number that precede it.
      int const listed = min_of(found_, size);
      std::uint32_t const old = g.rank() < listed ? entry(g.rank()) : ~0u;
      int place = 0;
      int old_place = g.rank();
      for (unsigned rest = there; rest != 0; rest &= rest - 1) {
        int const from = trailing_zeros(rest);
        int const other = g.shuffle(distance, from);
        place += static_cast<int>(other < distance || (other == distance && from < g.rank()));
        old_place += static_cast<int>(other < entry_distance(old));
      }
      for (int i = 0; i < listed; ++i) {
        place += static_cast<int>(entry_distance(g.shuffle(old, i)) <= distance);
      }
      g.sync();
      if (g.rank() < listed && old_place < size) { entry(old_place) = old; }
      if (distance >= 0 && place < size) { entry(place) = packed(distance, k); }
      found_ += popcount(there);
      g.sync();
    }
  }

  /// Removes the entries whose bits are set. @return how many were removed
  FT_HOST_DEVICE int take_out(Group g, unsigned places) {
    int const listed = listed_now();
    int left = 0;
    for (int base = 0; base < listed; base += g.size()) {
      int const i = base + g.rank();
      std::uint32_t const that = entry(min_of(i, listed - 1));
      bool const stays = i < listed && (places >> i & 1u) == 0;
      int stay = 0;
      int const place = left + g.exclusive_count(stays, stay);
      g.sync();
      if (stays) { entry(place) = that; }
      left += stay;
    }
    g.sync();
    taken_out_ = listed - left;
    return taken_out_;
  }

  /// Pads the last quad. @return number of listed candidates and search_workspace::unlisted; 0 if
  /// even the nearest is farther than `limit`
  FT_HOST_DEVICE int finish(Group g, int limit) {
    int const listed = listed_now();
    if (listed > 0 && entry_distance(entry(0)) > limit) { return 0; }
    for (int i = listed + g.rank(); i < (listed + 3) / 4 * 4; i += g.size()) { entry(i) = ~0u; }
    return listed + (unlisted() ? search_workspace::unlisted : 0);
  }

  /// Whether the nearest of `listed` candidates fails the ratio test.
  FT_HOST_DEVICE bool refused(search_params const& p, keypoints_view const& kp, int listed) const {
    return listed > 1 && refuses(p, kp, entry_distance(entry(0)), nearest(),
                                 entry_distance(entry(1)), entry_keypoint(entry(1)));
  }
  FT_HOST_DEVICE int nearest() const { return entry_keypoint(entry(0)); }
  /// Number of candidates added, which may exceed `size`.
  FT_HOST_DEVICE int found() const { return found_; }

private:
  FT_HOST_DEVICE static std::uint32_t packed(int distance, int k) {
    return static_cast<std::uint32_t>(distance) << 23 | static_cast<std::uint32_t>(k);
  }
  FT_HOST_DEVICE std::uint32_t& entry(int i) const { return to_[i / 4].entry[i % 4]; }

  FT_HOST_DEVICE int listed_now() const { return min_of(found_, size) - taken_out_; }
  FT_HOST_DEVICE bool unlisted() const { return found_ > size; }

  candidate_quad* to_;
  int found_ = 0;
  int taken_out_ = 0;
};

}  // namespace detail

}  // namespace FT_ABI
}  // namespace ft
