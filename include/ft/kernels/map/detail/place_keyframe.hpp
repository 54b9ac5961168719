// SPDX-License-Identifier: Apache-2.0
/// @file Makes room for a keyframe: removes points and old keyframes, and gives slots to new
/// points.
#pragma once

#include <cstddef>
#include <cstdint>

#include "ft/cameras/monocular_rig.hpp"
#include "ft/containers/odometry_map.hpp"
#include "ft/core/arithmetic.hpp"
#include "ft/core/atomics.hpp"
#include "ft/core/config.hpp"
#include "ft/core/group.hpp"
#include "ft/kernels/map/detail/select_new_points.hpp"
#include "ft/kernels/map/detail/slot_rows.hpp"
#include "ft/kernels/map/keyframe_input.hpp"
#include "ft/kernels/map/point_masks.hpp"
#include "ft/types/tracking.hpp"

namespace ft {
inline namespace FT_ABI {
namespace detail {

struct place_scratch {
  int freed[max_keyframes];  ///< points that become free when the keyframe of an age leaves
  int votes[max_keyframes];
  position_set leaving;
  int leaving_count;
};

/// Item: a batch entry. Everything about a new keyframe that is a choice; record_keypoint writes
/// the rest.
template <typename Rig>
struct place_keyframe {
  using scratch = place_scratch;
  using input = keyframe_input<Rig>;
  static constexpr int chosen = -2;  ///< holder of a keypoint that is to become a point
  static constexpr int depth_cameras = keyframe_task<Rig>::depth_cameras;

  template <typename Group>
  FT_HOST_DEVICE void operator()(Group g, scratch& s, int b, input const& in,
                                 keyframe_params const& params, odometry_map_view const& map,
                                 keyframe_result const& out, keyframe_workspace const& work) const {
    if (in.order[b] == keyframe_order::none) { return; }
    bool const fresh = in.order[b] == keyframe_order::begin_map;
    int const count = fresh ? 0 : map.keyframes.count[b];
    task const t{in, params, map, work, b, map.keyframes.made[b], count, map.records.used[b]};
    int const alive = cull(g, t, fresh);
    drop_dead_holders(g, t);
    int const wanted = list_new_points(g, t);
    share_with_partners(g, t);
    claim_points(g, t);
    choose_leaving(g, s, t, map.records.slots - alive < wanted ? wanted : 0);
    room const found = take_leave(g, s, t, wanted);
    int const made = min_of(wanted, found.free);
    make_points(g, t, wanted, made);
    link_neighbours(g, s, t);
    add_to_ring(g, s, t);
    int const held = count_held(g, t);
    if (g.rank() == 0) {
      map.records.alive[b] = found.alive + made;
      map.records.made[b] += made;
      int const last = made > 0 ? work.free_slots[t.first() + made - 1] : -1;
      map.records.used[b] = max_of(found.used, last + 1);
      out.held[b] = held;
      out.left_out[b] = wanted - made;
    }
  }

private:
  using task = keyframe_task<Rig>;
  struct room {
    int alive;  ///< points that stay
    int used;   ///< slots up to the last of them
    int free;   ///< free slots that were listed
  };

  /// Removes points that are seldom found, or all.
  /// @return number of points that stay
  template <typename Group>
  FT_HOST_DEVICE static int cull(Group g, task const& t, bool all) {
    point_records_view const& r = t.map.records;
    struct sightings_of_point {
      int number, visible, found;
    };
    int alive = 0;
    each_slot(
        g, 0, t.used,
        [&](int slot) {
          std::ptrdiff_t const at = r.at(t.b, slot);
          return sightings_of_point{r.number[at], r.visible[at], r.found[at]};
        },
        [&](int slot, sightings_of_point const& of) {
          bool const seldom =
              of.visible >= t.params.cull_after &&
              static_cast<std::int64_t>(of.found) * t.params.cull_share < of.visible;
          bool goes = all || seldom;
          if constexpr (is_monocular_v<typename task::rig_type>) {
            goes = goes || (of.number != 0 && is_doubtful(t, slot));
          }
          if (goes) { r.number[r.at(t.b, slot)] = 0; }
          alive += static_cast<int>(of.number != 0 && !goes);
          t.claimed(slot) = 0;
        });
    alive = g.reduce(alive, sum_op{});
    g.sync();
    return alive;
  }

  /// Whether a point of one camera was not seen again soon after it was made, or has lost the
  /// second of its observations: its depth is hardly known.
  FT_HOST_DEVICE static bool is_doubtful(task const& t, int slot) {
    keyframes_view const& keyframes = t.map.keyframes;
    point_records_view const& r = t.map.records;
    position_set const seen = position_set::of(r.mask(t.b, slot), r.words);
    int const oldest = t.made - t.count + 1;
    int const last = seen.last(keyframes.position(oldest));
    if (last < 0) { return true; }
    int const ago = (keyframes.position(t.made) - last + keyframes.positions) % keyframes.positions;
    int const observers = seen.count();
    bool const lonely = observers < 2 && ago > 0 && r.described[r.at(t.b, slot)] < 3;
    return lonely || (observers < 3 && ago > 2);
  }

  template <typename Group>
  FT_HOST_DEVICE static void drop_dead_holders(Group g, task const& t) {
    int const capacity = t.in.frame.capacity();
    for (int n = g.rank(); n < t.in.frame.numbers(); n += g.size()) {
      bool const there = n % capacity < t.keypoints(n / capacity);
      if (!there || !t.map.records.holds_point(t.b, t.holders()[n])) { t.holders()[n] = -1; }
    }
    g.sync();
  }

  /// Lists the left keypoints that are to become points, and marks them as `chosen`.
  template <typename Group>
  FT_HOST_DEVICE static int list_new_points(Group g, task const& t) {
    int listed = 0;
    FT_NO_UNROLL
    for (int c = 0; c < depth_cameras; ++c) {
      int const first = c * t.in.frame.capacity();
      stereo_keypoints const of{t.depth(c), t.keypoints(c), first, t.holders() + first,
                                t.work.new_points + t.first()};
      depth_limit const limit =
          nearest_depths(g, of.depth, of.count, near_limit(t.in.rig, c, t.params.near_depth),
                         t.params.wanted_near_points);
      listed = list_free(g, of, limit, chosen, listed);
    }
    g.sync();
    return listed;
  }
  /// The right keypoint of a stereo match that is not rectified holds what the left one holds.
  template <typename Group>
  FT_HOST_DEVICE static void share_with_partners(Group g, task const& t) {
    if (t.partners() == nullptr || t.in.frame.cameras < 2) { return; }
    for (int c = 0; c < t.in.frame.cameras; ++c) {
      if (!is_right(t, c)) { continue; }
      for (int i = g.rank(); i < t.keypoints(c); i += g.size()) {
        int const n = c * t.in.frame.capacity() + i;
        int const partner = t.partners()[n];
        int const holder = partner >= 0 ? t.holders()[partner] : -1;
        if (holder >= 0) { t.holders()[n] = holder; }
        if (holder == chosen) { t.holders()[n] = -1; }
      }
    }
    g.sync();
  }
  /// Whether camera c is the right one of a pair that is not rectified.
  FT_HOST_DEVICE static bool is_right(task const& t, int c) {
    if constexpr (is_mixed_v<typename task::rig_type>) {
      return t.in.rig.pair(c).left >= 0;
    } else {
      return c == 1;
    }
  }

  /// Each point goes to the first keypoint of a camera that holds it.
  template <typename Group>
  FT_HOST_DEVICE static void claim_points(Group g, task const& t) {
    int const capacity = t.in.frame.capacity();
    for (int n = g.rank(); n < t.in.frame.numbers(); n += g.size()) {
      int const slot = t.holders()[n];
      if (slot < 0) { continue; }
      for (int c = 0; c < t.in.frame.cameras; ++c) { t.claim(c, slot) = unclaimed; }
      t.claimed(slot) = 1;
    }
    g.sync();
    for (int n = g.rank(); n < t.in.frame.numbers(); n += g.size()) {
      int const slot = t.holders()[n];
      if (slot >= 0) { atomic_min(&t.claim(n / capacity, slot), n); }
    }
    g.sync();
  }

  struct slot_state {
    int number;
    unsigned char claimed;
    position_set seen;
  };
  FT_HOST_DEVICE static slot_state read_slot(task const& t, int slot) {
    point_records_view const& r = t.map.records;
    return {r.number[r.at(t.b, slot)], t.claimed(slot),
            position_set::of(r.mask(t.b, slot), r.words)};
  }

  /// The oldest keyframe leaves a full ring, and more of them while slots are short.
  /// @param wanted free slots
  template <typename Group>
  FT_HOST_DEVICE static void choose_leaving(Group g, scratch& s, task const& t, int wanted) {
    keyframes_view const& keyframes = t.map.keyframes;
    int const oldest = t.made - t.count + 1;
    int free = t.map.records.slots;
    if (wanted > 0) {
      for (int age = g.rank(); age < t.count; age += g.size()) { s.freed[age] = 0; }
      g.sync();
      int held = 0;
      int const begin = keyframes.position(oldest);
      each_slot(
          g, 0, t.used, [&](int slot) { return read_slot(t, slot); },
          [&](int, slot_state const& of) {
            if (of.number == 0) { return; }
            ++held;
            if (of.claimed != 0) { return; }
            int const newest = of.seen.last(begin);
            int const age = newest >= begin ? newest - begin : newest - begin + keyframes.positions;
            atomic_add(s.freed + age, 1);
          });
      free -= g.reduce(held, sum_op{});
      g.sync();
    }
    if (g.rank() == 0) {
      int leaving = 0;
      int const least = static_cast<int>(t.count == keyframes.positions);
      for (; leaving < t.count && (leaving < least || free < wanted); ++leaving) {
        if (wanted > 0) { free += s.freed[leaving]; }
      }
      s.leaving_count = leaving;
      s.leaving.assign(keyframes, oldest, oldest + leaving - 1);
    }
    g.sync();
  }

  /// Takes the leaving keyframes out of the masks and puts the new one in, frees the points that
  /// no keyframe sees, and lists free slots.
  template <typename Group>
  FT_HOST_DEVICE static room take_leave(Group g, scratch const& s, task const& t, int wanted) {
    point_records_view const& r = t.map.records;
    auto const free_slots = t.work.free_slots + t.first();
    int const end = min_of(r.slots, t.used + wanted);
    int const end_used = t.used;
    room found{0, 0, 0};
    slot_rows<Group> const rows(
        g, t.work.free_rows + static_cast<std::ptrdiff_t>(t.b) * ceil_div(r.slots, 32), end);
    rows.flag([&](int slot) { return read_slot(t, slot); },
              [&](int slot, slot_state const& of) {
                bool const stays = slot < end_used && update_mask(s, t, slot, of);
                found.alive += static_cast<int>(stays);
                if (stays) { found.used = slot + 1; }
                return !stays;
              });
    found.free = rows.list([&](int slot, int place) {
      if (place < wanted) { free_slots[place] = slot; }
    });
    found.alive = g.reduce(found.alive, sum_op{});
    found.used = g.reduce(found.used, max_op{});
    g.sync();
    return found;
  }

  /// @return whether the slot holds a point
  FT_HOST_DEVICE static bool update_mask(scratch const& s, task const& t, int slot,
                                         slot_state const& before) {
    bool const alive = before.number != 0;
    position_set after;
    bool changed = false;
    FT_UNROLL
    for (int w = 0; w < mask_words; ++w) {
      after.words[w] = alive ? before.seen.words[w] & ~s.leaving.words[w] : 0;
    }
    if (alive && before.claimed != 0) { after.add(t.position()); }
    FT_UNROLL
    for (int w = 0; w < mask_words; ++w) {
      changed = changed || after.words[w] != before.seen.words[w];
    }
    if (!changed) { return after.count() != 0; }
    if (after.count() == 0) {
      free_slot(t.map, t.b, slot);
      return false;
    }
    point_records_view const& r = t.map.records;
    after.write(r.mask(t.b, slot), r.words);
    get<field::observations>(t.map.points.slice(t.b), slot) = after.count();
    return true;
  }

  /// Gives the first `made` of the listed keypoints a point each.
  template <typename Group>
  FT_HOST_DEVICE static void make_points(Group g, task const& t, int wanted, int made) {
    point_records_view const& r = t.map.records;
    int const first = r.made[t.b] + 1;
    int const position = t.position();
    for (int j = g.rank(); j < wanted; j += g.size()) {
      int const n = t.work.new_points[t.first() + j];
      int const slot = j < made ? t.work.free_slots[t.first() + j] : -1;
      t.holders()[n] = slot;
      if (slot < 0) { continue; }
      std::ptrdiff_t const at = r.at(t.b, slot);
      r.number[at] = first + j;
      r.visible[at] = 1;
      r.found[at] = 1;
      r.found_frame[at] = 0;
      r.described[at] = 0;
      r.mask(t.b, slot)[position / 64] = std::uint64_t{1} << (position % 64);
      get<field::observations>(t.map.points.slice(t.b), slot) = 1;
      for (int c = 0; c < t.in.frame.cameras; ++c) { t.claim(c, slot) = unclaimed; }
      t.claim(n / t.in.frame.capacity(), slot) = n;
      if (t.partners() == nullptr || t.in.frame.cameras < 2) { continue; }
      int const partner = t.partners()[n];
      bool const mutual = partner >= 0 && t.partners()[partner] == n;
      if (!mutual) { continue; }
      t.claim(partner / t.in.frame.capacity(), slot) = partner;
      t.holders()[partner] = slot;
    }
    g.sync();
  }

  /// The new keyframe's neighbour is the one that shares most points with it, the newest of
  /// equals. It becomes the neighbour of those that share as many points with it as with theirs.
  template <typename Group>
  FT_HOST_DEVICE static void link_neighbours(Group g, scratch& s, task const& t) {
    keyframes_view const& keyframes = t.map.keyframes;
    for (int p = g.rank(); p < max_keyframes; p += g.size()) { s.votes[p] = 0; }
    g.sync();
    auto const part = g.part();
    int const numbers = t.in.frame.numbers();
    for (int first = g.part_index() * part.size(); first < numbers; first += g.size()) {
      int const n = first + part.rank();
      int const slot = n < numbers ? t.holders()[n] : -1;
      int const c = n / t.in.frame.capacity();
      bool votes = slot >= 0 && t.claim(c, slot) == n;  // a point once
      for (int before = 0; votes && before < c; ++before) {
        votes = t.claim(before, slot) == unclaimed;
      }
      add_votes(part, s.votes, votes ? t.map.records.mask(t.b, slot) : nullptr,
                t.map.records.words);
    }
    g.sync();
    unsigned long long best = 0;
    int const oldest = t.made - t.count + 1 + s.leaving_count;
    for (int number = oldest + g.rank(); number <= t.made; number += g.size()) {
      int const votes = s.votes[keyframes.position(number)];
      std::ptrdiff_t const at = keyframes.at(t.b, keyframes.position(number));
      bool const alone = keyframes.neighbour[at] < oldest;
      if (votes > 0 && (alone || votes >= keyframes.shared[at])) {
        keyframes.neighbour[at] = t.made + 1;
        keyframes.shared[at] = votes;
      } else if (alone) {
        keyframes.neighbour[at] = 0;
        keyframes.shared[at] = 0;
      }
      auto const key = static_cast<unsigned long long>(votes) << 32 | static_cast<unsigned>(number);
      best = votes > 0 && key > best ? key : best;
    }
    best = g.reduce(best, max_op{});
    if (g.rank() == 0) {
      std::ptrdiff_t const at = keyframes.at(t.b, t.position());
      keyframes.neighbour[at] = static_cast<int>(best & 0xffffffffu);
      keyframes.shared[at] = static_cast<int>(best >> 32);
    }
  }

  template <typename Group>
  FT_HOST_DEVICE static void add_to_ring(Group g, scratch const& s, task const& t) {
    keyframes_view const& keyframes = t.map.keyframes;
    if (g.rank() != 0) { return; }
    std::ptrdiff_t const at = keyframes.at(t.b, t.position());
    keyframes.T_cw[at] = t.in.T_cw[t.b];
    keyframes.time_ns[at] = t.in.time_ns[t.b];
    for (int c = 0; c < keyframes.cameras; ++c) {
      keyframes.keypoints[at * keyframes.cameras + c] = t.keypoints(c);
    }
    keyframes.made[t.b] = t.made + 1;
    keyframes.count[t.b] = t.count - s.leaving_count + 1;
  }

  template <typename Group>
  FT_HOST_DEVICE static int count_held(Group g, task const& t) {
    int held = 0;
    for (int c = 0; c < depth_cameras; ++c) {
      int const* const holders = t.holders() + c * t.in.frame.capacity();
      for (int i = g.rank(); i < t.keypoints(c); i += g.size()) {
        held += static_cast<int>(holders[i] >= 0);
      }
    }
    return g.reduce(held, sum_op{});
  }
};

}  // namespace detail
}  // namespace FT_ABI
}  // namespace ft
