// SPDX-License-Identifier: Apache-2.0
/// @file Stage: matches between two frames of one camera, with which a map is started. Source:
/// Mur-Artal et al., "ORB-SLAM: a versatile and accurate monocular SLAM system", T-RO 2015.
#pragma once

#include <cstddef>
#include <cstdint>
#include <type_traits>

#include "ft/containers/feature_grid.hpp"
#include "ft/containers/keypoints.hpp"
#include "ft/core/arithmetic.hpp"
#include "ft/core/atomics.hpp"
#include "ft/core/bits.hpp"
#include "ft/core/config.hpp"
#include "ft/core/error.hpp"
#include "ft/core/execution.hpp"
#include "ft/core/group.hpp"
#include "ft/core/memory.hpp"
#include "ft/kernels/search/detail/candidate_list.hpp"
#include "ft/kernels/search/detail/orientation_check.hpp"
#include "ft/kernels/search/workspace.hpp"
#include "ft/types/odometry_params.hpp"
#include "ft/types/poses.hpp"

namespace ft {
inline namespace FT_ABI {

/// Two frames; batch entry b of each belongs together. Keypoints have undistorted positions.
struct frame_pair_view {
  keypoints_view first;
  keypoints_view second;
  feature_grid_view grids;  ///< of `second`
};

/// @throws bad_argument naming the value and the limit
inline void check(initial_match_params const& p) {
  detail::require_range("window_radius", p.window_radius, 0.1f, 1e6f);
  detail::require_range("max_hamming", p.max_hamming, 0, 255);
  detail::require_range("ratio", p.ratio, 0.0f, 100.0f);
}

/// Matches of a batch of frame pairs.
struct initial_matches_view {
  int capacity = 0;  ///< keypoints of a first frame
  int batch = 0;
  /// [batch][capacity] where a keypoint of the first frame is searched, pixels; in and out. Starts
  /// as the keypoint's position. A match sets it to that of the second frame's keypoint.
  vec2<float>* previous = nullptr;
  int* match = nullptr;  ///< [batch][capacity] keypoint of the second frame, -1 = none
  int* count = nullptr;  ///< [batch] matches
};
static_assert(std::is_trivially_copyable<initial_matches_view>::value, "passed to kernels");

inline void carve(carver& c, initial_matches_view& v, int capacity, int batch) {
  v.capacity = capacity;
  v.batch = batch;
  c.place({batch, capacity}, v.previous, v.match);
  c.place({batch}, v.count);
}

/// Working memory of search_initial_matches().
struct initial_match_workspace {
  static constexpr int list_size = search_workspace::list_size;
  int capacity = 0;         ///< keypoints of a first frame
  int second_capacity = 0;  ///< of a second one
  /// [batch][capacity][list_size / 4] candidates by distance, ties in grid order
  candidate_quad* list = nullptr;
  int* list_count = nullptr;  ///< [batch][capacity] as in search_workspace
  int* choice = nullptr;      ///< [batch][capacity] keypoint that was accepted, maybe lost again
  /// [batch][second capacity] distance and owner of a keypoint of the second frame, packed as a
  /// candidate; ~0 = none.
  std::uint32_t* owner = nullptr;

  FT_HOST_DEVICE std::ptrdiff_t at(int b, int i) const {
    return static_cast<std::ptrdiff_t>(b) * capacity + i;
  }
};

/// @param capacity,second_capacity keypoints of a first and of a second frame, below 2^23
inline void carve(carver& c, initial_match_workspace& v, int capacity, int second_capacity,
                  int batch) {
  v.capacity = capacity;
  v.second_capacity = second_capacity;
  c.place({batch, capacity, initial_match_workspace::list_size / 4}, v.list);
  c.place({batch, capacity}, v.list_count, v.choice);
  c.place({batch, second_capacity}, v.owner);
}

namespace detail {

/// One pair of a search for initial matches.
struct initial_search {
  keypoints_view first, second;
  feature_grid_view grid;
  initial_match_params const& params;
  vec2<float>* previous;

  FT_HOST_DEVICE initial_search(int b, frame_pair_view const& frames,
                                initial_match_params const& with, initial_matches_view const& out)
      : first(frames.first.slice(b)),
        second(frames.second.slice(b)),
        grid(frames.grids.slice(b)),
        params(with),
        previous(out.previous + static_cast<std::ptrdiff_t>(b) * out.capacity) {}

  /// Where keypoint i of the first frame is searched.
  FT_HOST_DEVICE search_window window(int i) const {
    search_window w = search_window::none();
    w.x = previous[i].x;
    w.y = previous[i].y;
    w.radius = params.window_radius;
    return w;
  }
  /// Largest distance that can matter, as the best or the second best one.
  FT_HOST_DEVICE int limit() const {
    search_params p;
    p.kind = search_kind::local_map;
    p.max_hamming = params.max_hamming;
    p.ratio = params.ratio;
    return listed_distance(p);
  }
};

/// Item: a keypoint of a first frame. Lists its nearest candidates.
struct list_initial_candidates {
  static constexpr int quads = initial_match_workspace::list_size / 4;
  struct scratch {
    candidate_quad list[quads];
  };

  template <typename Group>
  FT_HOST_DEVICE void operator()(Group g, scratch& s, int item, frame_pair_view const& frames,
                                 initial_match_params const& params,
                                 initial_matches_view const& out,
                                 initial_match_workspace const& work) const {
    int const b = item / work.capacity;
    int const i = item % work.capacity;
    initial_search const in(b, frames, params, out);
    if (i >= *in.first.count) { return; }
    int count = 0;
    if (in.first.octave(i) == 0) {
      search_window const w = in.window(i);
      descriptor const wanted = in.first.orb(i);
      int const limit = in.limit();
      candidate_list<Group> list(s.list);
      visit_cells(g, w, in.grid, [&](int k) {
        int const distance =
            k >= 0 ? candidate_distance(w, in.second, nullptr, wanted, k, limit) : -1;
        list.add(g, distance, k);
      });
      count = list.finish(g, params.max_hamming);
      g.sync();
      int const listed = count & search_workspace::counted;
      for (int q = g.rank(); 4 * q < listed; q += g.size()) {
        work.list[item * static_cast<std::ptrdiff_t>(quads) + q] = s.list[q];
      }
    }
    if (g.rank() == 0) { work.list_count[item] = count; }
  }
};

/// Item: a pair of frames. Goes through the first one's keypoints in order, then checks rotations.
struct assign_initial_matches {
  struct scratch {
    static constexpr int size = 8192;  ///< keypoints of the second frame whose owners fit
    std::uint32_t owner[size];
    int histogram[rotations::bins];
  };

  template <typename Group>
  FT_HOST_DEVICE void operator()(Group g, scratch& s, int b, frame_pair_view const& frames,
                                 initial_match_params const& params,
                                 initial_matches_view const& out,
                                 initial_match_workspace const& work) const {
    initial_search const in(b, frames, params, out);
    int* const match = out.match + work.at(b, 0);
    int* const choice = work.choice + work.at(b, 0);
    int const n = *in.first.count;
    int const second_n = *in.second.count;
    std::uint32_t* const owner =
        second_n <= scratch::size
            ? s.owner
            : work.owner + static_cast<std::ptrdiff_t>(b) * work.second_capacity;
    for (int i = g.rank(); i < out.capacity; i += g.size()) { match[i] = choice[i] = -1; }
    for (int k = g.rank(); k < second_n; k += g.size()) { owner[k] = ~0u; }
    for (int r = g.rank(); r < rotations::bins; r += g.size()) { s.histogram[r] = 0; }
    g.sync();
    if (g.part_index() == 0) { take_in_order(g.part(), in, n, {b, work, owner, choice}); }
    g.sync();
    // Without the check all matches share one bin.
    auto const bin = [&](int i) {
      return params.orientation_check
                 ? rotations::bin(in.first.angle(i), in.second.angle(choice[i]))
                 : 0;
    };
    for (int i = g.rank(); i < n; i += g.size()) {
      if (choice[i] >= 0) { atomic_add(s.histogram + bin(i), 1); }
    }
    g.sync();
    auto const most = rotations::of(g.part(), s.histogram);
    int matches = 0;
    for (int k = g.rank(); k < second_n; k += g.size()) {
      int const i = owner[k] == ~0u ? -1 : entry_keypoint(owner[k]);
      if (i < 0 || !most.has(bin(i))) { continue; }
      match[i] = k;
      in.previous[i] = {in.second.x(k), in.second.y(k)};
      ++matches;
    }
    matches = g.reduce(matches, sum_op{});
    if (g.rank() == 0) { out.count[b] = matches; }
  }

private:
  /// State of a pair.
  struct progress {
    int b;
    initial_match_workspace const& work;
    std::uint32_t* owner;
    int* choice;

    /// Whether an earlier keypoint has k at this distance or a smaller one.
    FT_HOST_DEVICE bool passes_over(int k, int distance) const {
      return entry_distance(owner[k]) <= distance;
    }
  };
  /// The two nearest candidates that are not passed over.
  struct found_two {
    int best = -1;  ///< keypoint, -1 = none
    int distance = 0;
    int second = -1;  ///< distance, -1 = none
  };

  /// All keypoints of the first frame, in order, by one warp.
  template <typename Part>
  FT_HOST_DEVICE static void take_in_order(Part w, initial_search const& in, int n,
                                           progress const& now) {
    for (int base = 0; base < n; base += w.size()) {
      int const mine = base + w.rank();
      int const counted = mine < n ? now.work.list_count[now.work.at(now.b, mine)] : 0;
      for (unsigned open = w.ballot(counted != 0); open != 0; open &= open - 1) {
        int const from = trailing_zeros(open);
        int const i = base + from;
        int const count = w.shuffle(counted, from);
        found_two found = nearest_listed(w, now, i, count & search_workspace::counted);
        if (found.second < 0 && (count & search_workspace::unlisted) != 0) {
          found = nearest_in_window(w, in, now, i);
        }
        if (accepted(in.params, found) && w.rank() == 0) {
          now.owner[found.best] =
              static_cast<std::uint32_t>(found.distance) << 23 | static_cast<std::uint32_t>(i);
          now.choice[i] = found.best;
        }
        w.sync();
      }
    }
  }

  template <typename Part>
  FT_HOST_DEVICE static found_two nearest_listed(Part w, progress const& now, int i, int listed) {
    found_two found;
    auto const* const list = now.work.list + now.work.at(now.b, i) * list_initial_candidates::quads;
    for (int base = 0; base < listed && found.second < 0; base += w.size()) {
      int const place = base + w.rank();
      std::uint32_t const entry = place < listed ? list[place / 4].entry[place % 4] : 0u;
      bool const free =
          place < listed && !now.passes_over(entry_keypoint(entry), entry_distance(entry));
      for (unsigned rest = w.ballot(free); rest != 0 && found.second < 0; rest &= rest - 1) {
        std::uint32_t const next = w.shuffle(entry, trailing_zeros(rest));
        if (found.best >= 0) {
          found.second = entry_distance(next);
        } else {
          found.best = entry_keypoint(next);
          found.distance = entry_distance(next);
        }
      }
    }
    return found;
  }

  /// The same among all keypoints of the window, for lists that do not say.
  template <typename Part>
  FT_HOST_DEVICE static found_two nearest_in_window(Part w, initial_search const& in,
                                                    progress const& now, int i) {
    search_window const window = in.window(i);
    descriptor const wanted = in.first.orb(i);
    int const limit = in.limit();
    two_nearest mine;
    int mine_k = -1;
    int at = w.rank();
    visit_cells(w, window, in.grid, [&](int k) {
      int const distance =
          k >= 0 ? candidate_distance(window, in.second, nullptr, wanted, k, limit) : -1;
      if (distance >= 0 && !now.passes_over(k, distance)) {
        if (distance < mine.first) { mine_k = k; }
        mine.add(distance, at);
      }
      at += w.size();
    });
    two_nearest const all = mine.merged(w);
    found_two found;
    if (all.first == two_nearest::none) { return found; }
    found.best = w.reduce(mine.index == all.index ? mine_k : -1, max_op{});
    found.distance = all.first;
    if (all.second != two_nearest::none) { found.second = all.second; }
    return found;
  }

  FT_HOST_DEVICE static bool accepted(initial_match_params const& params, found_two const& found) {
    if (found.best < 0 || found.distance > params.max_hamming) { return false; }
    // A missing second one is as far as an int says, as in the reference.
    auto const second = found.second < 0 ? 2147483648.0f : static_cast<float>(found.second);
    return static_cast<float>(found.distance) < mul(params.ratio, second);
  }
};

}  // namespace detail

/// Search for the initial matches of a map: keypoints of octave 0 in windows around
/// `out.previous`. In the order of the first frame's keypoints, each takes the nearest keypoint of
/// the second frame, from an earlier one if it is nearer than that one; the earlier one then has no
/// match. Keypoints that an earlier one has at the same or a smaller distance are no candidates.
///
/// Writes `out.match`, `out.count`, and `out.previous` where there is a match. Asynchronous on
/// `exec`; allocates nothing; two launches.
/// @throws bad_argument for capacities that differ, or a parameter out of range
template <typename Exec>
void search_initial_matches(Exec const& exec, frame_pair_view const& frames,
                            initial_match_params const& params, initial_matches_view const& out,
                            initial_match_workspace const& work) {
  int const first = frames.first.capacity;
  int const second = frames.second.capacity;
  check(params);
  initial_match_params scaled = params;
  scaled.max_hamming = detail::descriptor_scale::limit(params.max_hamming);
  detail::require_range("keypoints of the first frame", first, 1, (1 << 23) - 1);
  detail::require_range("keypoints of the second frame", second, 1, (1 << 23) - 1);
  detail::require_range("capacity of the matches", out.capacity, first, first);
  detail::require_range("capacity of the workspace", work.capacity, first, first);
  detail::require_range("second capacity of the workspace", work.second_capacity, second, second);
  detail::require_items("pairs times keypoints", static_cast<std::size_t>(out.batch),
                        static_cast<std::size_t>(first));
  for_each_item<per_warp>(exec, out.batch * first, detail::list_initial_candidates{}, frames,
                          scaled, out, work);
  for_each_item<per_block<512>>(exec, out.batch, detail::assign_initial_matches{}, frames, scaled,
                                out, work);
}

}  // namespace FT_ABI
}  // namespace ft
