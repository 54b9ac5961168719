// SPDX-License-Identifier: Apache-2.0
/// @file Stage: search by projection, from the last frame and in the local map.
/// Source: specification sections 9 and 10.
///
/// The searches are sequential by definition: map points come in order, and a keypoint taken by one
/// is not there for the next. Here all points list their best candidates at once; then, again and
/// again, every point chooses as if the lower ones had made their last choices for good. The lowest
/// point is right at once, and a point is right once all below it are: the only choices that do not
/// change any more are those of the sequential loop. In practice a few turns are enough.
#pragma once

#include <cmath>
#include <cstddef>
#include <cstdint>
#include <type_traits>

#include "ft/cameras/stereo_rig.hpp"
#include "ft/containers/feature_grid.hpp"
#include "ft/containers/image_pyramid.hpp"
#include "ft/containers/keypoints.hpp"
#include "ft/containers/map_points.hpp"
#include "ft/core/config.hpp"
#include "ft/core/execution.hpp"
#include "ft/kernels/search_window.hpp"

namespace ft {
inline namespace FT_ABI {

/// The current frame as the searches see it. One camera, or two of a fisheye pair: keypoints of
/// camera c of batch entry b are batch entry `keypoint_step * b + c` of `keypoints`. Keypoint k of
/// camera c has number c * capacity + k in the arrays below, which have `cameras * capacity`
/// entries per batch entry.
struct frame_view {
  keypoints_view keypoints;
  int keypoint_step = 2;
  int cameras = 1;
  int batch = 1;
  feature_grid_view grids;  ///< batch entry cameras * b + c
  float const* right_x =
      nullptr;  ///< [batch][capacity] column in the right image, -1 = none; or null
  int const* partner = nullptr;  ///< number of the stereo partner, -1 = none; or null
  int* holder = nullptr;         ///< slot of the map point that a keypoint holds, -1 = none

  FT_HOST_DEVICE int capacity() const { return keypoints.capacity; }
  FT_HOST_DEVICE int numbers() const { return cameras * keypoints.capacity; }
  FT_HOST_DEVICE keypoints_view camera(int b, int c) const {
    return keypoints.slice(keypoint_step * b + c);
  }
};

enum class search_kind {
  last_frame,  ///< no ratio test; the right camera only where the left window held a keypoint
  local_map,   ///< ratio test; a refusal on the left ends the point; stereo partners are taken too
};

struct search_params {
  search_kind kind = search_kind::local_map;
  int max_distance = 100;   ///< descriptors differ in at most this many bits
  float ratio = 0.8f;       ///< best over second best, same octave; local map only
  bool from_empty = false;  ///< nobody holds a keypoint: holders are cleared first
  /// The candidates are listed while frame.right_x is not there yet: it is looked at when they are
  /// chosen from. Last frame only.
  bool right_later = false;
  /// The candidates are listed while frame.holder and the points' stamps are not there yet:
  /// leave_out() follows. Local map only.
  bool holders_later = false;
};

/// Four candidates of a window, each distance << 23 | keypoint.
struct alignas(16) candidate_quad {
  std::uint32_t entry[4];
};

/// Which map points were seen in which frame: written after a search, so that the next leaves them
/// out.
struct point_stamps {
  int const* frame = nullptr;  ///< [batch] number of this frame
  int* seen = nullptr;  ///< [batch][map slots] number of the frame that held a point last, or null

  /// Whether a slot of batch entry b was seen in this frame. @param slots of a map
  FT_HOST_DEVICE bool stamped(int b, int slots, int slot) const {
    return seen != nullptr && seen[static_cast<std::ptrdiff_t>(b) * slots + slot] == frame[b];
  }
};

/// Candidates of one search and the state of the assignment.
struct search_workspace {
  /// The best candidates of a window are listed; who needs more walks the grid again.
  static constexpr int list_size = 16;
  /// [cameras][batch][capacity][list_size / 4], the nearest first, of equals the first in the grid;
  /// filled up with ~0 to whole quads
  candidate_quad* list = nullptr;
  static constexpr int observed = 1 << 30;
  static constexpr int left_out = 1 << 29;
  static constexpr int unlisted = 1 << 28;
  static constexpr int counted = unlisted - 1;
  /// [cameras][batch][capacity] how many are listed, 0 where a window can take none of them; plus
  /// `unlisted` where there are farther ones, `observed` where the point looked for is that, and
  /// `left_out` where candidates are not listed since they are taken
  int* list_count = nullptr;
  /// [cameras][batch][capacity] keypoint taken by each window, -1 = none. Who lists the candidates
  /// begins with what a window of the local map would take if it were alone.
  int* match = nullptr;
  int* open = nullptr;    ///< [batch][capacity] points that have candidates
  int* writer = nullptr;  ///< [batch][numbers] who owns or writes a keypoint
  int* before = nullptr;  ///< [batch][links] a second such table, or links of chains of writers
  std::uint8_t* held = nullptr;  ///< [batch][numbers] 1 = taken before the search
  int* matches = nullptr;        ///< [batch] keypoints that were given a point
  int capacity = 0;              ///< windows
  int links = 0;
  int batch = 0;
  int cameras = 1;

  FT_HOST_DEVICE std::ptrdiff_t window(int camera, int b, int i) const {
    return (static_cast<std::ptrdiff_t>(camera) * batch + b) * capacity + i;
  }
  std::size_t list_bytes() const {
    return static_cast<std::size_t>(window(cameras, 0, 0)) * (list_size / 4) *
           sizeof(candidate_quad);
  }
};

inline void carve(carver& c, search_workspace& v, int windows, int keypoints, int batch,
                  int cameras) {
  v.capacity = windows;
  v.batch = batch;
  v.cameras = cameras;
  std::size_t const b = static_cast<std::size_t>(batch);
  std::size_t const per_camera = detail::checked_mul(b, static_cast<std::size_t>(windows));
  std::size_t const n = detail::checked_mul(static_cast<std::size_t>(cameras), per_camera);
  std::size_t const numbers =
      b * static_cast<std::size_t>(cameras) * static_cast<std::size_t>(keypoints);
  v.list = c.take<candidate_quad>(detail::checked_mul(n, search_workspace::list_size / 4));
  v.list_count = c.take<int>(n);
  v.match = c.take<int>(n);
  v.open = c.take<int>(per_camera);
  v.writer = c.take<int>(numbers);
  // As many as there are writes in a search, and at least one a keypoint.
  v.links = max_of(2 * cameras * windows, cameras * keypoints);
  v.before = c.take<int>(detail::checked_mul(b, static_cast<std::size_t>(v.links)));
  v.held = c.take<std::uint8_t>(numbers);
  v.matches = c.take<int>(b);
}

namespace detail {

/// Largest descriptor distance that can matter: to be taken, or to be second best.
FT_HOST_DEVICE inline int listed_distance(search_params const& p) {
  if (!(p.kind == search_kind::local_map && p.ratio > 0)) { return p.max_distance; }
  float const second = min_of(static_cast<float>(p.max_distance) / p.ratio, 256.0f);
  return max_of(p.max_distance, min_of(256, static_cast<int>(second) + 1));
}

/// Whether a keypoint with column r in the right image, -1 = none, is elsewhere than in the window.
FT_HOST_DEVICE inline bool misses_right(search_window const& w, float r) {
  return w.check_right && r > 0 && ::fabsf(w.right_x - r) > w.radius;
}

/// Distance of keypoint k where it can be a candidate at all, else -1; whatever holds it.
FT_HOST_DEVICE inline int candidate_distance(search_window const& w, keypoints_view const& kp,
                                             float const* right_x, descriptor const& wanted, int k,
                                             int limit) {
  if (!inside(w, kp, k)) { return -1; }
  if (right_x != nullptr && misses_right(w, right_x[k])) { return -1; }
  int const distance = hamming(wanted, get<field::orb>(kp, k));
  return distance <= limit ? distance : -1;
}

/// Whether a window's best candidate is not better enough than its second best, -1 = none.
FT_HOST_DEVICE inline bool refuses(search_params const& p, keypoints_view const& kp, int best,
                                   int best_k, int second, int second_k) {
  return p.kind == search_kind::local_map && second_k >= 0 &&
         static_cast<float>(best) > mul(p.ratio, static_cast<float>(second)) &&
         get<field::octave>(kp, best_k) == get<field::octave>(kp, second_k);
}

FT_HOST_DEVICE inline int entry_distance(std::uint32_t entry) {
  return static_cast<int>(entry >> 23);
}
FT_HOST_DEVICE inline int entry_keypoint(std::uint32_t entry) {
  return static_cast<int>(entry & 0x7fffffu);
}

/// use(i, load(i)) for all i < n; each thread has `Ahead` loads under way at a time.
template <int Ahead, typename Group, typename Load, typename Use>
FT_HOST_DEVICE void load_ahead(Group g, int n, Load const& load, Use const& use) {
  for (int first = g.rank(); first < n; first += Ahead * g.size()) {
    decltype(load(0)) loaded[Ahead];
    FT_UNROLL
    for (int t = 0; t < Ahead; ++t) { loaded[t] = load(min_of(first + t * g.size(), n - 1)); }
    FT_UNROLL
    for (int t = 0; t < Ahead; ++t) {
      int const i = first + t * g.size();
      if (i < n) { use(i, loaded[t]); }
    }
  }
}

/// Keeps the best candidates of a window in order: nearest first, of equals the one that came
/// first.
/// @tparam Group one thread or a warp
template <typename Group>
class candidate_list {
public:
  static constexpr int size = search_workspace::list_size;

  /// @param found so many are there already
  FT_HOST_DEVICE explicit candidate_list(candidate_quad* to, int found = 0)
      : to_(to), found_(found) {}

  /// Candidates in the order of ranks; a negative distance is none.
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
      // Everybody's place is the number of those that come before.
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

  /// Takes out those whose places have a bit. Returns how many these were.
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

  /// Fills up the last quad. Returns how many are listed, 0 where the best is farther than `limit`,
  /// plus search_workspace::unlisted.
  FT_HOST_DEVICE int finish(Group g, int limit) {
    int const listed = listed_now();
    if (listed > 0 && entry_distance(entry(0)) > limit) { return 0; }
    for (int i = listed + g.rank(); i < (listed + 3) / 4 * 4; i += g.size()) { entry(i) = ~0u; }
    return listed + (unlisted() ? search_workspace::unlisted : 0);
  }

  /// Whether a window that is alone, and listed so many, refuses the nearest.
  FT_HOST_DEVICE bool refused(search_params const& p, keypoints_view const& kp, int listed) const {
    return listed > 1 && refuses(p, kp, entry_distance(entry(0)), nearest(),
                                 entry_distance(entry(1)), entry_keypoint(entry(1)));
  }
  FT_HOST_DEVICE int nearest() const { return entry_keypoint(entry(0)); }
  /// How many there were, may exceed what is listed.
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

/// One point: the candidates in its windows.
struct list_candidates {
  static constexpr int quads = search_workspace::list_size / 4;
  /// Of a warp: lists while they are made.
  struct scratch {
    candidate_quad list[2][quads];
    // Where holders come later:
    int found[2];
    bool observed[2];  ///< the point that is looked for
  };

  template <typename Group>
  FT_HOST_DEVICE void operator()(Group g, scratch& s, int item, frame_view const& frame,
                                 map_points_view const& map, search_windows_view const& windows,
                                 search_params const& params, search_workspace const& work) const {
    int const b = item / windows.capacity;
    int const i = item % windows.capacity;
    if (i >= windows.count[b]) { return; }
    window_pair pair;
    pair.of[0] = windows.at(0, b, i);
    if (frame.cameras == 2) { pair.of[1] = windows.at(1, b, i); }
    list(g, s, b, i, pair, frame, map, params, work);
  }

  /// Point i of batch entry b.
  template <typename Group>
  FT_HOST_DEVICE static void list(Group g, scratch& s, int b, int i, window_pair const& windows,
                                  frame_view const& frame, map_points_view const& map,
                                  search_params const& params, search_workspace const& work) {
    map_points_view const points = map.slice(b);
    int const limit = detail::listed_distance(params);
    int const* const holder = holders(b, frame, params);
    float const* const right_x =
        frame.right_x == nullptr || params.right_later
            ? nullptr
            : frame.right_x + static_cast<std::ptrdiff_t>(b) * frame.capacity();
    bool left_empty = false;
    bool refused = false;
    for (int c = 0; c < frame.cameras; ++c) {
      bool left_out = false;
      search_window const w = windows.camera(c);
      detail::candidate_list<Group> list(s.list[c]);
      bool in_window = false;
      if (w.slot >= 0 && !left_empty) {
        keypoints_view const kp = frame.camera(b, c);
        descriptor const wanted = get<field::orb>(points, w.slot);
        visit_cells(g, w, frame.grids.slice(frame.cameras * b + c), [&](int k) {
          int distance = -1;
          if (k >= 0) {
            int const held = holder == nullptr ? -1 : holder[c * frame.capacity() + k];
            distance =
                detail::candidate_distance(w, kp, c == 0 ? right_x : nullptr, wanted, k, limit);
            if (distance >= 0 && keeps(points, held)) {
              distance = -1;
              left_out = true;
            }
            in_window = in_window || inside(w, kp, k);
          }
          list.add(g, distance, k);
        });
      }
      bool const observed = w.slot >= 0 && keeps(points, w.slot);
      if (!params.holders_later) {
        write(g, s, b, i, c, observed, list, left_out, refused, frame, params, work);
      } else if (g.rank() == 0) {
        s.found[c] = list.found();
        s.observed[c] = observed;
      }
      if (params.kind == search_kind::last_frame && frame.cameras == 2) {
        left_empty = g.ballot(in_window) == 0;
      }
    }
    g.sync();
  }

  /// Which of the candidates that list() listed are held, bit 16 * camera + place: a warp looks all
  /// of them up at once. For leave_out().
  template <typename Group>
  FT_HOST_DEVICE static unsigned held(Group g, scratch const& s, int b, frame_view const& frame,
                                      map_points_view const& map, search_params params) {
    constexpr int size = search_workspace::list_size;
    static_assert(size == 16 && (Group::max_threads == 1 || Group::max_threads == 32), "bits");
    params.holders_later = false;
    int const* const holder = holders(b, frame, params);
    unsigned bits = 0;
    for (int base = 0; base < size * frame.cameras; base += g.size()) {
      int const c = (base + g.rank()) / size;
      int const place = (base + g.rank()) % size;
      bool const listed = c < frame.cameras && place < s.found[c];
      int const k = listed ? detail::entry_keypoint(s.list[c][place / 4].entry[place % 4]) : 0;
      int const slot = listed && holder != nullptr ? holder[c * frame.capacity() + k] : -1;
      bits |= g.ballot(keeps(map.slice(b), slot)) << base;
    }
    return bits;
  }

  /// What list() does at once where the holders are there. @param taken_bits what held() said
  template <typename Group>
  FT_HOST_DEVICE static void leave_out(Group g, scratch& s, int b, int i, unsigned taken_bits,
                                       frame_view const& frame, search_params const& params,
                                       search_workspace const& work) {
    bool refused = false;
    for (int c = 0; c < frame.cameras; ++c) {
      detail::candidate_list<Group> list(s.list[c], s.found[c]);
      int const taken = list.take_out(g, taken_bits >> (search_workspace::list_size * c));
      write(g, s, b, i, c, s.observed[c], list, taken > 0, refused, frame, params, work);
    }
  }

private:
  /// Null where nobody holds anything yet.
  FT_HOST_DEVICE static int const* holders(int b, frame_view const& frame,
                                           search_params const& params) {
    bool const none = params.from_empty || params.holders_later;
    return none ? nullptr : frame.holder + static_cast<std::ptrdiff_t>(b) * frame.numbers();
  }
  /// Whether the point in a slot, -1 = none, keeps a keypoint that it holds: what is taken stays
  /// taken, but where a point without observations takes it over as a partner.
  FT_HOST_DEVICE static bool keeps(map_points_view const& points, int slot) {
    return slot >= 0 && get<field::observations>(points, slot) > 0;
  }

  /// The list of window i of camera c. @param observed the point looked for is that
  /// @param left_out of any thread: something taken is not in it
  /// @param refused see assign_keypoints::choose
  template <typename Group>
  FT_HOST_DEVICE static void write(Group g, scratch& s, int b, int i, int c, bool observed,
                                   detail::candidate_list<Group>& list, bool left_out,
                                   bool& refused, frame_view const& frame,
                                   search_params const& params, search_workspace const& work) {
    std::ptrdiff_t const at = work.window(c, b, i);
    int found = list.finish(g, params.max_distance);
    int const listed = found & search_workspace::counted;
    int first = -1;
    if (params.kind == search_kind::local_map && listed > 0 && !refused) {
      bool const alike = list.refused(params, frame.camera(b, c), listed);
      first = alike ? -1 : list.nearest();
      refused = alike && c == 0;
    }
    g.sync();
    for (int q = g.rank(); 4 * q < listed; q += g.size()) {
      work.list[at * quads + q] = s.list[c][q];
    }
    if (frame.cameras == 2 && g.ballot(left_out) != 0) { found |= search_workspace::left_out; }
    if (found != 0 && observed) { found |= search_workspace::observed; }
    if (g.rank() == 0) {
      work.list_count[at] = found;
      work.match[at] = first;
    }
    g.sync();
  }
};

/// Threads of a block that assigns the keypoints of a frame.
inline constexpr int assign_threads = 1024;

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

}  // namespace detail

/// All windows of one frame: who takes which keypoint.
/// @tparam Turns true: all points choose at once, until nothing changes; false: the plain loop, for
///   groups of one thread
/// @tparam Single one camera, and no stereo partners: the same with fewer instructions, which is
///   what a block that is alone waits for. Chosen by assign() itself.
template <bool Turns, bool Single = false>
struct assign_keypoints {
  /// Frames of up to so many keypoints, and searches of so many points with candidates, keep their
  /// state in block scratch, others in the workspace.
  static constexpr int scratch_size = detail::assign_scratch::size;
  using scratch = std::conditional_t<Turns, detail::assign_scratch, no_scratch>;

  static constexpr bool prepares = true;
  /// Empties the tables.
  template <typename Group, typename... Args>
  FT_HOST_DEVICE static void prepare(Group g, scratch& s, int, frame_view const& frame,
                                     Args const&...) {
    if constexpr (Turns) {
      if (in_scratch(frame)) { empty(g, s, s.writer, s.before, frame.numbers()); }
    }
  }

  template <typename Group>
  FT_HOST_DEVICE void operator()(Group g, scratch& s, int b, frame_view const& frame,
                                 map_points_view const& map, search_windows_view const& windows,
                                 search_params const& params, search_workspace const& work) const {
    assign(g, s, b, frame, map, windows, params, work, true,
           [](auto, int const*) { return false; });
  }

  /// The same. Where every window has one keypoint at most, and every keypoint one owner or nobody,
  /// calls write(single, owners) first, with a constant `Single` and, for each keypoint, list_size
  /// times a window and more, or nobody. Returns true, and writes nothing, if that did. `s` but for
  /// what `owners` points to is free then.
  /// @param prepared prepare() was called, and nothing else since
  template <typename Group, typename Write>
  FT_HOST_DEVICE static bool assign(Group g, scratch& s, int b, frame_view const& frame,
                                    map_points_view const& map, search_windows_view const& windows,
                                    search_params const& params, search_workspace const& work,
                                    bool prepared, Write const& write) {
    static_assert(Turns || Group::max_threads == 1, "the plain loop is for one thread");
    bool const partners = frame.partner != nullptr && params.kind == search_kind::local_map;
    if constexpr (Turns && !Single) {
      if (frame.cameras == 1 && !partners) {
        return assign_keypoints<Turns, true>::assign(g, s, b, frame, map, windows, params, work,
                                                     prepared, write);
      }
    }
    context const ctx{b,
                      frame,
                      map.slice(b),
                      windows,
                      params,
                      work,
                      frame.holder + static_cast<std::ptrdiff_t>(b) * frame.numbers(),
                      partners && !Single
                          ? frame.partner + static_cast<std::ptrdiff_t>(b) * frame.numbers()
                          : nullptr,
                      frame.right_x == nullptr || !params.right_later
                          ? nullptr
                          : frame.right_x + static_cast<std::ptrdiff_t>(b) * frame.capacity()};
    if constexpr (Turns) {
      auto const empty_all = [&] { empty(g, s, owners(s, ctx), seconds(s, ctx), frame.numbers()); };
      if (!prepared || !in_scratch(frame)) { empty_all(); }
      g.sync();
      bool const proposes = params.kind == search_kind::last_frame;
      if (proposes && let_propose(g, s, ctx)) {
        bool const simple = in_scratch(frame) && s.guests == 0 && params.from_empty;
        using single = std::integral_constant<bool, Single>;
        if (simple && write(single{}, static_cast<int const*>(s.writer))) { return true; }
        write_proposed(g, s, ctx);
      } else {
        if (proposes) {
          empty_all();
          g.sync();
        }
        take_turns(g, s, ctx);
      }
    } else {
      one_after_another(ctx);
    }
    return false;
  }

  static constexpr int nobody = 0x7fffffff;
  static constexpr int list_size = search_workspace::list_size;

private:
  struct context {
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
  FT_HOST_DEVICE static bool has_candidates(int count, bool all) {
    constexpr int some = search_workspace::counted | search_workspace::unlisted;
    return (count & (some | (all ? search_workspace::left_out : 0))) != 0;
  }

  FT_HOST_DEVICE static void one_after_another(context const& ctx) {
    int const numbers = ctx.numbers();
    for (int k = 0; ctx.params.from_empty && k < numbers; ++k) { ctx.holder[k] = -1; }
    int taken = 0;
    bool guests = false;  // what was taken may not be any more
    for (int i = 0; i < ctx.windows.count[ctx.b]; ++i) {
      bool refused = false;
      for (int c = 0; c < ctx.cameras(); ++c) {
        bool const any = has_candidates(ctx.list_count(c, i), guests);
        int const k = choose(ctx, c, i, window_list(ctx, c, i, any, guests), refused,
                             [&](int number, bool) { return ctx.observed(ctx.holder[number]); });
        ctx.match(c, i) = k;
        if (k < 0) { continue; }
        guests = guests || !ctx.observed(ctx.slot(c, i));
        int const partner = ctx.partner_of(ctx.number(c, k));
        ctx.holder[ctx.number(c, k)] = ctx.slot(c, i);
        if (partner >= 0) { ctx.holder[partner] = ctx.slot(c, i); }
        taken += partner >= 0 ? 2 : 1;
      }
    }
    ctx.work.matches[ctx.b] = taken;
  }

  /// Without a ratio test every window wants the nearest keypoint that it can have, and a keypoint
  /// belongs to the lowest that wants it: proposals, in any order and all at once, end in the
  /// assignment of the sequential loop (Gale and Shapley, "College admissions and the stability of
  /// marriage", 1962). False where a list was at its end.
  template <typename Group>
  FT_HOST_DEVICE static bool let_propose(Group g, scratch& s, context const& ctx) {
    // One call for both would hide from compilers what is in block scratch.
    if (in_scratch(ctx.frame)) {
      let_propose(g, s, ctx, s.writer);
    } else {
      let_propose(g, s, ctx, owners(s, ctx));
    }
    g.sync();
    if (s.list_ended == 0) { return true; }
    g.sync();
    return false;
  }
  template <typename Group>
  FT_HOST_DEVICE static void let_propose(Group g, scratch& s, context const& ctx, int* owner) {
    int const n = ctx.windows.count[ctx.b];
    auto const camera = [n](int w) { return Single || w < n ? 0 : 1; };
    detail::load_ahead<2>(
        g, ctx.cameras() * n,
        [&](int w) { return proposal::from(ctx, camera(w), w - camera(w) * n, 0); },
        [&](int w, proposal const& first) {
          if ((first.count & search_workspace::observed) != 0) {
            propose(s, ctx, camera(w), w - camera(w) * n, first, owner);
          } else if (has_candidates(first.count, false)) {
            s.guests = 1;
          }
        });
  }

  /// Whether block scratch has place for a table of keypoints.
  FT_HOST_DEVICE static bool in_scratch(frame_view const& frame) {
    return frame.numbers() <= scratch_size;
  }
  /// Of a keypoint: list_size times the window that has it, plus its place in the window's list.
  FT_HOST_DEVICE static int* owners(scratch& s, context const& ctx) {
    return in_scratch(ctx.frame)
               ? s.writer
               : ctx.work.writer + static_cast<std::ptrdiff_t>(ctx.b) * ctx.numbers();
  }
  /// The other table of keypoints.
  FT_HOST_DEVICE static int* seconds(scratch& s, context const& ctx) {
    return in_scratch(ctx.frame)
               ? s.before
               : ctx.work.before + static_cast<std::ptrdiff_t>(ctx.b) * ctx.work.links;
  }
  /// Nobody has or writes a keypoint yet.
  template <typename Group>
  FT_HOST_DEVICE static void empty(Group g, scratch& s, int* writer, int* before, int numbers) {
    for (int k = g.rank(); k < numbers; k += g.size()) { writer[k] = before[k] = nobody; }
    if (g.rank() == 0) {
      s.open_count = 0;
      s.list_ended = 0;
      s.guests = 0;
      s.first_changed[0] = nobody;
    }
  }

  /// What the proposals have led to. Those that look for points without observations choose now:
  /// they keep nobody away.
  template <typename Group>
  FT_HOST_DEVICE static void write_proposed(Group g, scratch& s, context const& ctx) {
    int const numbers = ctx.numbers();
    int const n = ctx.windows.count[ctx.b];
    int const* const owner = owners(s, ctx);
    // The last of them that took a keypoint.
    int* const guest = seconds(s, ctx);
    int taken = 0;
    bool const guests = s.guests != 0;
    if (guests) {
      for (int k = g.rank(); k < numbers; k += g.size()) { guest[k] = -1; }
      g.sync();
      for (int c = 0; c < ctx.cameras(); ++c) {
        for (int i = g.rank(); i < n; i += g.size()) {
          // Nothing that was left out comes back here: there are no partners.
          int const count = ctx.list_count(c, i);
          if (!has_candidates(count, false) || (count & search_workspace::observed) != 0) {
            continue;
          }
          bool refused = false;
          int const k =
              choose(ctx, c, i, window_list(ctx, c, i, true, false), refused,
                     [&](int number, bool listed) {
                       return owner[number] / list_size < i || (!listed && ctx.held(number));
                     });
          ctx.match(c, i) = k;
          if (k < 0) { continue; }
          atomic_max(guest + ctx.number(c, k), i);
          ++taken;
        }
      }
      g.sync();
    }
    for (int number = g.rank(); number < numbers; number += g.size()) {
      int const c = ctx.camera_of(number);
      if (owner[number] != nobody) {
        int const i = owner[number] / list_size;
        ctx.match(c, i) = number - c * ctx.frame.capacity();
        ctx.holder[number] = ctx.slot(c, i);
        ++taken;
      } else if (guests && guest[number] >= 0) {
        ctx.holder[number] = ctx.slot(c, guest[number]);
      } else if (ctx.params.from_empty) {
        ctx.holder[number] = -1;
      }
    }
    taken = g.reduce(taken, sum_op{});
    if (g.rank() == 0) { ctx.work.matches[ctx.b] = taken; }
  }

  /// What a window looks at to propose, loaded together.
  struct proposal {
    int count;            ///< as in search_workspace
    std::uint32_t entry;  ///< of its list
    bool check_right;     ///< as in search_window
    float right_x, radius;

    FT_HOST_DEVICE static proposal from(context const& ctx, int c, int i, int place) {
      proposal p{};
      p.count = ctx.list_count(c, i);
      p.entry = ctx.list(c, i)[place / 4].entry[place % 4];
      if (ctx.right_x != nullptr && c == 0) {
        search_window const& w = ctx.windows.at(0, ctx.b, i);
        p.check_right = w.check_right;
        p.right_x = w.right_x;
        p.radius = w.radius;
      }
      return p;
    }
    FT_HOST_DEVICE bool misses_right(context const& ctx, int k) const {
      if (!check_right) { return false; }
      float const r = ctx.right_x[k];
      return r > 0 && ::fabsf(right_x - r) > radius;
    }
  };

  /// Window i proposes; when it drives another one out, goes on for that one.
  FT_HOST_DEVICE static void propose(scratch& s, context const& ctx, int c, int i, proposal now,
                                     int* owner) {
    int place = 0;
    for (;;) {
      if (place >= (now.count & search_workspace::counted)) {
        if ((now.count & search_workspace::unlisted) != 0) { s.list_ended = 1; }
        return;
      }
      if (detail::entry_distance(now.entry) > ctx.params.max_distance) { return; }
      int const k = detail::entry_keypoint(now.entry);
      int const mine = i * list_size + place;
      int before = -1;
      if (!now.misses_right(ctx, k)) { before = atomic_min(owner + ctx.number(c, k), mine); }
      if (before == nobody) { return; }
      if (before > mine) {
        i = before / list_size;
        place = before % list_size;
      }
      ++place;
      now = proposal::from(ctx, c, i, min_of(place, list_size - 1));
    }
  }

  /// The points that have candidates. They are numbered anew, in their order; what point p writes
  /// has the numbers from writes() * p on, in the order of writing.
  struct open_points {
    static constexpr int observed_left = 1 << 30;
    static constexpr int observed_right = 1 << 29;
    static constexpr int any_left = 1 << 28;
    static constexpr int any_right = 1 << 27;
    int* list;  ///< index of a point, which windows have candidates and look for what is observed
    int count;
    int cameras_;
    int partners_;

    FT_HOST_DEVICE int cameras() const { return Single ? 1 : cameras_; }
    /// 1 = stereo partners are taken, too
    FT_HOST_DEVICE int partners() const { return Single ? 0 : partners_; }

    /// Point i in `list`, 0 where it has no candidates. @param counts of its windows, as in
    /// search_workspace @param all those that were not listed are some
    FT_HOST_DEVICE static int entry(int i, int const (&counts)[2], bool all) {
      bool const left = has_candidates(counts[0], all);
      bool const right = has_candidates(counts[1], all);
      constexpr int observed = search_workspace::observed;
      int flags = left ? any_left : 0;
      flags |= right ? any_right : 0;
      flags |= left && (counts[0] & observed) != 0 ? observed_left : 0;
      flags |= right && (counts[1] & observed) != 0 ? observed_right : 0;
      return flags != 0 ? i | flags : 0;
    }
    /// Whether a window with candidates looks for what is not observed.
    FT_HOST_DEVICE static bool guest(int entry) {
      return ((entry & any_left) != 0 && (entry & observed_left) == 0) ||
             ((entry & any_right) != 0 && (entry & observed_right) == 0);
    }
    /// Of a point; 1, 2 or 4.
    FT_HOST_DEVICE int writes() const { return cameras() << partners(); }
    FT_HOST_DEVICE int index(int p) const { return list[p] & (any_right - 1); }
    FT_HOST_DEVICE bool any(int p, int camera) const {
      return (list[p] & (camera == 0 ? any_left : any_right)) != 0;
    }
    FT_HOST_DEVICE bool observed(int p, int camera) const {
      return (list[p] & (camera == 0 ? observed_left : observed_right)) != 0;
    }
    /// Whether what a write gives a keypoint to is observed.
    FT_HOST_DEVICE bool observed(int write) const {
      return observed(write >> (cameras() - 1 + partners()),
                      (write >> partners()) & (cameras() - 1));
    }
  };

  /// What the points wrote in a turn, where all that is looked for is observed: a keypoint is taken
  /// from its first write on, and that is all that is kept of the writes to it.
  ///
  /// One table has those of the turn before, the other gets those of this turn. Every turn adds a
  /// lower base to its writes' numbers than the turns before: nothing need be cleared in between.
  struct first_writes {
    static constexpr bool kept_at_once = true;
    int* last;  ///< of a keypoint: base + its first write; more, where it has none
    int* now;   ///< the same of this turn
    int numbers;
    int writes;  ///< in a turn, at most
    int base;
    int base_now;

    /// @param a,b emptied
    FT_HOST_DEVICE first_writes(int* a, int* b, int keypoints, int most)
        : last(a),
          now(b),
          numbers(keypoints),
          writes(most),
          base(nobody - most),
          base_now(nobody - most) {}

    /// The turn before is the one that just ended, for all threads.
    template <typename Group>
    FT_HOST_DEVICE void next_turn(Group g, context const&, open_points const&) {
      int* const other = last;
      int const other_base = base;
      last = now;
      base = base_now;
      now = other;
      base_now = other_base - writes;
      if (base_now >= 0) { return; }
      for (int k = g.rank(); k < numbers; k += g.size()) { now[k] = nobody; }
      base_now = nobody - writes;
      g.sync();
    }
    FT_HOST_DEVICE void add(int number, int write) const {
      atomic_min(now + number, base_now + write);
    }
    FT_HOST_DEVICE bool written(int number) const { return last[number] < base + writes; }
    /// Whether a keypoint is taken before the write `end`. @param listed it is in a list
    FT_HOST_DEVICE bool taken(context const& ctx, open_points const&, int number, int end,
                              bool listed) const {
      return last[number] < base + end || (!listed && ctx.held(number));
    }
    /// When the turns are over: finds the last write to each keypoint.
    template <typename Group>
    FT_HOST_DEVICE void find_last(Group g, context const& ctx, open_points const& open) const {
      if (open.partners() == 0) { return; }  // there is one
      for (int p = g.rank(); p < open.count; p += g.size()) {
        each_write(ctx, open, p, last_choice(ctx, open, p),
                   [&](int, int number, int w) { atomic_min(now + number, -1 - w); });
      }
      g.sync();
    }
    FT_HOST_DEVICE bool is_last(open_points const& open, int number, int write) const {
      return open.partners() == 0 || now[number] == -1 - write;
    }
  };

  /// The same where some of what is looked for is not observed: all writes to a keypoint, in a
  /// chain.
  struct write_chains {
    static constexpr bool kept_at_once = false;
    int* first;          ///< of a keypoint: first in the chain, -1 = nothing writes it
    int* next;           ///< of a write: next in the chain, -1 = none
    std::uint8_t* held;  ///< of a keypoint: 1 = taken before the search
    int numbers;

    template <typename Group>
    FT_HOST_DEVICE void clear(Group g) const {
      for (int k = g.rank(); k < numbers; k += g.size()) { first[k] = -1; }
    }
    template <typename Group>
    FT_HOST_DEVICE void next_turn(Group g, context const& ctx, open_points const& open) const {
      clear(g);
      g.sync();
      for (int p = g.rank(); p < open.count; p += g.size()) {
        each_write(ctx, open, p, last_choice(ctx, open, p),
                   [&](int, int number, int w) { add(number, w); });
      }
      g.sync();
    }
    FT_HOST_DEVICE void add(int number, int write) const {
      next[write] = atomic_exchange(first + number, write);
    }
    FT_HOST_DEVICE bool written(int number) const { return first[number] >= 0; }
    FT_HOST_DEVICE bool taken(context const&, open_points const& open, int number, int end,
                              bool) const {
      int const write = last_write(number, end);
      return write < 0 ? held[number] != 0 : open.observed(write);
    }
    template <typename Group>
    FT_HOST_DEVICE void find_last(Group, context const&, open_points const&) const {}
    FT_HOST_DEVICE bool is_last(open_points const&, int number, int write) const {
      return last_write(number, nobody) == write;
    }

  private:
    /// The last write to a keypoint below `end`, -1 = none.
    FT_HOST_DEVICE int last_write(int number, int end) const {
      int last = -1;
      for (int w = first[number]; w >= 0; w = next[w]) {
        if (w < end) { last = max_of(last, w); }
      }
      return last;
    }
  };

  template <typename Group>
  FT_HOST_DEVICE static void take_turns(Group g, scratch& s, context const& ctx) {
    int const numbers = ctx.numbers();
    int const n = ctx.windows.count[ctx.b];
    std::ptrdiff_t const at = ctx.b;
    open_points open{n <= scratch_size ? s.open : ctx.work.open + at * ctx.work.capacity, 0,
                     ctx.cameras(), ctx.partners() ? 1 : 0};
    int* const writer = owners(s, ctx);
    first_writes firsts(writer, seconds(s, ctx), numbers, n * open.writes());
    if (g.rank() == 0) { ctx.work.matches[ctx.b] = 0; }
    bool const alone = Single && in_scratch(ctx.frame) && n <= scratch_size &&
                       ctx.params.kind == search_kind::local_map;
    if (alone) {
      if (settle_single(g, s, ctx, n)) { return; }
      list_open(g, s, ctx, n, open, false, [](int, choice const&) {});
    } else {
      list_open(g, s, ctx, n, open, false, [&](int p, choice const& first) {
        each_write(ctx, open, p, first, [&](int, int number, int w) { firsts.add(number, w); });
      });
    }
    g.sync();
    if (s.guests == 0) {
      firsts.next_turn(g, ctx, open);
      settle(g, s, ctx, open, firsts);
    } else {
      if (open.cameras() == 2) {
        list_open(g, s, ctx, n, open, true, [](int, choice const&) {});
      }
      write_chains const chains{
          writer,
          open.count * open.writes() <= scratch_size ? s.before
                                                     : ctx.work.before + at * ctx.work.links,
          in_scratch(ctx.frame) ? s.held : ctx.work.held + at * numbers, numbers};
      for (int k = g.rank(); k < numbers; k += g.size()) {
        chains.held[k] = static_cast<std::uint8_t>(ctx.held(k));
      }
      chains.next_turn(g, ctx, open);
      settle(g, s, ctx, open, chains);
    }
  }

  /// A point with candidates of a search with one camera, without partners, in a word.
  struct packed_point {
    static constexpr int some_unlisted = 1 << 17;
    int word;  ///< index, 12 bits; 5: how many are listed; whether others are not; choice + 1

    static_assert(scratch_size < 1 << 12 && search_workspace::list_size < 1 << 5, "bits");
    FT_HOST_DEVICE static packed_point of(int i, int count, int k) {
      int const listed = count & search_workspace::counted;
      return {i | listed << 12 | ((count & search_workspace::unlisted) != 0 ? some_unlisted : 0) |
              (k + 1) << 18};
    }
    FT_HOST_DEVICE int index() const { return word & 0xfff; }
    FT_HOST_DEVICE int listed() const { return word >> 12 & 0x1f; }
    FT_HOST_DEVICE bool unlisted() const { return (word & some_unlisted) != 0; }
    FT_HOST_DEVICE int choice() const { return (word >> 18) - 1; }
    FT_HOST_DEVICE packed_point with(int k) const { return {(word & 0x3ffff) | (k + 1) << 18}; }
  };

  /// The turns with first writes, where there is one camera and no partner: in a word each, points
  /// come in any order, and a write has its point's index for a number. False, and nothing is
  /// written, where somebody looks for a point without observations.
  /// @param n points, at most scratch_size, as are the keypoints
  template <typename Group>
  FT_HOST_DEVICE static bool settle_single(Group g, scratch& s, context const& ctx, int n) {
    // Not through owners(): it has to be known where they compile that this is block scratch.
    first_writes writes(s.writer, s.before, ctx.numbers(), n);
    constexpr int steps = 3;
    auto const part = g.part();
    for (int first = 0; first < n; first += steps * g.size()) {
      int const begin = first + steps * part.size() * g.part_index() + part.rank();
      int counts[steps], made[steps], before[steps];
      FT_UNROLL
      for (int t = 0; t < steps; ++t) {
        int const i = begin + t * part.size();
        counts[t] = i < n ? ctx.list_count(0, i) : 0;
        made[t] = i < n ? ctx.match(0, i) : -1;
      }
      int mine = 0;
      FT_UNROLL
      for (int t = 0; t < steps; ++t) {
        int here = 0;
        before[t] = mine + part.exclusive_count(has_candidates(counts[t], false), here);
        mine += here;
      }
      int place = 0;
      if (part.rank() == 0) { place = atomic_add(&s.open_count, mine); }
      place = part.shuffle(place, 0);
      FT_UNROLL
      for (int t = 0; t < steps; ++t) {
        if (!has_candidates(counts[t], false)) { continue; }
        int const i = begin + t * part.size();
        if ((counts[t] & search_workspace::observed) == 0) { s.guests = 1; }
        s.open[place + before[t]] = packed_point::of(i, counts[t], made[t]).word;
        if (made[t] >= 0) { writes.add(made[t], i); }
      }
    }
    g.sync();
    int const count = s.open_count;
    bool const guests = s.guests != 0;
    g.sync();
    if (guests) { return false; }
    open_points const unused{};
    writes.next_turn(g, ctx, unused);
    // Points below `begin` do not change any more.
    int begin = 0;
    for (int turn = 0;; turn = (turn + 1) % 3) {
      if (g.rank() == 0) { s.first_changed[(turn + 1) % 3] = nobody; }
      for (int p = g.rank(); p < count; p += g.size()) {
        packed_point const point{s.open[p]};
        int const i = point.index();
        int k = point.choice();
        if (i >= begin) {
          int const chosen = choose_nearest(ctx, point, writes);
          if (chosen != k) {
            k = chosen;
            s.open[p] = point.with(k).word;
            atomic_min(s.first_changed + turn, i);
          }
        }
        if (k >= 0) { writes.add(k, i); }
      }
      g.sync();
      int const changed = s.first_changed[turn];
      if (changed == nobody) { break; }
      begin = changed + 1;
      writes.next_turn(g, ctx, unused);
    }
    int taken = 0;
    for (int p = g.rank(); p < count; p += g.size()) {
      packed_point const point{s.open[p]};
      int const slot = ctx.slot(0, point.index());
      int const k = point.choice();
      ctx.match(0, point.index()) = k;
      if (k < 0) { continue; }
      ctx.holder[k] = slot;
      ++taken;
    }
    for (int k = g.rank(); ctx.params.from_empty && k < ctx.numbers(); k += g.size()) {
      if (!writes.written(k)) { ctx.holder[k] = -1; }
    }
    taken = part.reduce(taken, sum_op{});
    if (part.rank() == 0) { atomic_add(ctx.work.matches + ctx.b, taken); }
    return true;
  }

  /// As choose(). Most decide on the first four of their list: these are looked at together.
  FT_HOST_DEVICE static int choose_nearest(context const& ctx, packed_point point,
                                           first_writes const& writes) {
    int const i = point.index();
    int const listed = point.listed();
    std::uint32_t best = ~0u;
    std::uint32_t second = ~0u;
    if (listed > 0) {
      candidate_quad const quad = *ctx.list(0, i);
      FT_UNROLL
      for (int e = 3; e >= 0; --e) {
        std::uint32_t const entry = quad.entry[e];
        bool free = e < listed;
        if (free) { free = writes.last[detail::entry_keypoint(entry)] >= writes.base + i; }
        second = free ? best : second;
        best = free ? entry : best;
      }
    }
    // What is not there is farther than all that are.
    bool const near = detail::entry_distance(best) <= ctx.params.max_distance;
    bool const all = listed <= 4 && !point.unlisted();
    if (second == ~0u && !all && (near || best == ~0u)) {
      bool refused = false;
      open_points const unused{};
      return choose(
          ctx, 0, i, window_list(ctx, 0, i, true, false), refused,
          [&](int number, bool in_list) { return writes.taken(ctx, unused, number, i, in_list); });
    }
    if (!near || best == ~0u) { return -1; }
    int const k = detail::entry_keypoint(best);
    int const second_k = second == ~0u ? -1 : detail::entry_keypoint(second);
    bool const refused =
        detail::refuses(ctx.params, ctx.frame.camera(ctx.b, 0), detail::entry_distance(best), k,
                        detail::entry_distance(second), second_k);
    return refused ? -1 : k;
  }

  /// Turns until nobody chooses anew. Then writes what came of it.
  template <typename Group, typename Writes>
  FT_HOST_DEVICE static void settle(Group g, scratch& s, context const& ctx,
                                    open_points const& open, Writes writes) {
    // Below `begin` nothing changes any more.
    int begin = 0;
    for (int turn = 0;; turn = (turn + 1) % 3) {
      if (g.rank() == 0) { s.first_changed[(turn + 1) % 3] = nobody; }
      for (int p = g.rank(); p < open.count; p += g.size()) {
        choice made = last_choice(ctx, open, p);
        if (p >= begin && choose_anew(ctx, open, writes, p, made)) {
          atomic_min(s.first_changed + turn, p);
        }
        if constexpr (Writes::kept_at_once) {
          each_write(ctx, open, p, made, [&](int, int number, int w) { writes.add(number, w); });
        }
      }
      g.sync();
      int const changed = s.first_changed[turn];
      if (changed == nobody) { break; }
      begin = changed + 1;
      writes.next_turn(g, ctx, open);
    }
    writes.find_last(g, ctx, open);
    int taken = 0;
    for (int p = g.rank(); p < open.count; p += g.size()) {
      int const i = open.index(p);
      each_write(ctx, open, p, last_choice(ctx, open, p), [&](int c, int number, int w) {
        if (writes.is_last(open, number, w)) { ctx.holder[number] = ctx.slot(c, i); }
        ++taken;
      });
    }
    for (int k = g.rank(); ctx.params.from_empty && k < ctx.numbers(); k += g.size()) {
      if (!writes.written(k)) { ctx.holder[k] = -1; }
    }
    taken = g.part().reduce(taken, sum_op{});
    if (g.part().rank() == 0) { atomic_add(ctx.work.matches + ctx.b, taken); }
  }

  /// Keypoints that a point takes, -1 = none.
  struct choice {
    int k[2] = {-1, -1};
  };
  FT_HOST_DEVICE static choice last_choice(context const& ctx, open_points const& open, int p) {
    choice made;
    FT_UNROLL
    for (int c = 0; c < 2; ++c) {
      if (c < open.cameras() && open.any(p, c)) { made.k[c] = ctx.match(c, open.index(p)); }
    }
    return made;
  }

  /// Calls visit(camera, keypoint's number, write) for what point p writes.
  template <typename Visit>
  FT_HOST_DEVICE static void each_write(context const& ctx, open_points const& open, int p,
                                        choice const& made, Visit const& visit) {
    FT_UNROLL
    for (int c = 0; c < 2; ++c) {
      if (made.k[c] < 0) { continue; }
      int const number = ctx.number(c, made.k[c]);
      int const at = p * open.writes() + (c << open.partners());
      visit(c, number, at);
      int const partner = ctx.partner_of(number);
      if (partner >= 0) { visit(c, partner, at + 1); }
    }
  }
  /// Lists the first n points that have candidates, in order; the others take nothing. Calls
  /// visit(p, first choice) for each.
  /// @param all also those of whose candidates none is listed
  template <typename Group, typename Visit>
  FT_HOST_DEVICE static void list_open(Group g, scratch& s, context const& ctx, int n,
                                       open_points& open, bool all, Visit const& visit) {
    // Neighbouring threads look at neighbouring points, and each at several at a time: loads that
    // wait together, and one scan for all of them.
    constexpr int steps = 4;
    auto const part = g.part();
    open.count = 0;
    for (int first = 0; first < n; first += steps * g.size()) {
      int const begin = first + steps * part.size() * g.part_index() + part.rank();
      int counts[steps][2];
      choice made[steps];
      FT_UNROLL
      for (int t = 0; t < steps; ++t) {
        int const i = begin + t * part.size();
        FT_UNROLL
        for (int c = 0; c < 2; ++c) {
          bool const there = i < n && c < open.cameras();
          counts[t][c] = there ? ctx.list_count(c, i) : 0;
          made[t].k[c] = there ? ctx.match(c, i) : -1;
        }
      }
      int entry[steps];
      int mine = 0;
      FT_UNROLL
      for (int t = 0; t < steps; ++t) {
        entry[t] = open_points::entry(begin + t * part.size(), counts[t], all);
        mine += static_cast<int>(entry[t] != 0);
      }
      int found = 0;
      int place = open.count + part.shuffle(g.exclusive_scan(mine, found), 0);
      FT_UNROLL
      for (int t = 0; t < steps; ++t) {
        int here = 0;
        int const before = part.exclusive_count(entry[t] != 0, here);
        if (entry[t] != 0) {
          open.list[place + before] = entry[t];
          if (open_points::guest(entry[t])) { s.guests = 1; }
          visit(place + before, made[t]);
        }
        place += here;
      }
      open.count += found;
    }
  }

  /// Point p's choice after the writes of the turn before. True if it is not what it was.
  template <typename Writes>
  FT_HOST_DEVICE static bool choose_anew(context const& ctx, open_points const& open,
                                         Writes const& writes, int p, choice& made) {
    int const i = open.index(p);
    int const end = p * open.writes();
    window_list const lists[2] = {window_list(ctx, 0, i, open.any(p, 0), !Writes::kept_at_once),
                                  window_list(ctx, 1, i, open.any(p, 1), !Writes::kept_at_once)};
    bool changed = false;
    bool refused = false;
    int own = -1;  // the partner of what the left window takes
    FT_UNROLL
    for (int c = 0; c < 2; ++c) {
      if (c >= open.cameras()) { break; }
      int const k = choose(ctx, c, i, lists[c], refused, [&](int number, bool listed) {
        return number == own ? open.observed(p, 0) : writes.taken(ctx, open, number, end, listed);
      });
      if (k >= 0 && c == 0) { own = ctx.partner_of(k); }
      if (k == made.k[c]) { continue; }
      changed = true;
      made.k[c] = k;
      ctx.match(c, i) = k;
    }
    return changed;
  }

  /// A window's candidates: how many, and the nearest, loaded together.
  struct window_list {
    int n = 0;
    bool complete = true;   ///< what was left out is of no use
    bool unlisted = false;  ///< there are farther ones
    candidate_quad nearest{};

    /// @param guests what was taken may not be any more: those left out count
    FT_HOST_DEVICE window_list(context const& ctx, int c, int i, bool any, bool guests) {
      if (!any) { return; }
      int const count = ctx.list_count(c, i);
      n = count & search_workspace::counted;
      unlisted = (count & search_workspace::unlisted) != 0;
      complete = !guests || (count & search_workspace::left_out) == 0;
      if (!guests || n > 0) { nearest = *ctx.list(c, i); }
    }
  };

  /// The two nearest keypoints of a window that are not taken.
  struct nearest_two {
    int best = 256;
    int second = 256;
    int best_k = -1;
    int second_k = -1;

    FT_HOST_DEVICE void add(int k, int distance) {
      if (distance < best) {
        second = best;
        second_k = best_k;
        best = distance;
        best_k = k;
      } else if (distance < second) {
        second = distance;
        second_k = k;
      }
    }
  };

  /// The keypoint that window i of camera c takes, -1 = none. @param refused set by a window whose
  /// best is not better enough than its second best; then the point's next window takes nothing
  /// @param taken of a keypoint's number, and whether that is in the list
  template <typename Taken>
  FT_HOST_DEVICE static int choose(context const& ctx, int c, int i, window_list const& list,
                                   bool& refused, Taken const& taken) {
    if (refused) { return -1; }
    bool const with_ratio = ctx.params.kind == search_kind::local_map;
    nearest_two found;
    if (!choose_from_list(ctx, c, i, list, with_ratio, taken, found)) {
      found = {};
      choose_from_grid(ctx, c, i, taken, found);
    }
    if (found.best_k < 0 || found.best > ctx.params.max_distance) { return -1; }
    if (detail::refuses(ctx.params, ctx.frame.camera(ctx.b, c), found.best, found.best_k,
                        found.second, found.second_k)) {
      refused = c == 0;
      return -1;
    }
    return found.best_k;
  }

  /// False where the list is at its end, and candidates are left that it does not hold.
  template <typename Taken>
  FT_HOST_DEVICE static bool choose_from_list(context const& ctx, int c, int i,
                                              window_list const& list, bool with_ratio,
                                              Taken const& taken, nearest_two& found) {
    int const n = list.n;
    if (!list.complete) { return false; }
    candidate_quad quad = list.nearest;
    FT_NO_UNROLL
    for (int q = 0; 4 * q < n; ++q) {
      if (q > 0) { quad = ctx.list(c, i)[q]; }
      FT_UNROLL
      for (int e = 0; e < 4; ++e) {
        int const distance = detail::entry_distance(quad.entry[e]);
        int const k = detail::entry_keypoint(quad.entry[e]);
        if (4 * q + e >= n) { return !list.unlisted; }
        if (found.best_k < 0 && distance > ctx.params.max_distance) { return true; }
        if (taken(ctx.number(c, k), true) || ctx.misses_right(c, i, k)) { continue; }
        found.add(k, distance);
        if (!with_ratio || found.second_k >= 0) { return true; }
      }
    }
    return !list.unlisted;
  }

  template <typename Taken>
  FT_HOST_DEVICE static void choose_from_grid(context const& ctx, int c, int i, Taken const& taken,
                                              nearest_two& found) {
    search_window const w = ctx.windows.at(c, ctx.b, i);
    keypoints_view const kp = ctx.frame.camera(ctx.b, c);
    descriptor const wanted = get<field::orb>(ctx.points, w.slot);
    int const limit = detail::listed_distance(ctx.params);
    float const* const right_x =
        ctx.frame.right_x == nullptr || c != 0
            ? nullptr
            : ctx.frame.right_x + static_cast<std::ptrdiff_t>(ctx.b) * ctx.frame.capacity();
    visit_cells(single_group{}, w, ctx.frame.grids.slice(ctx.cameras() * ctx.b + c), [&](int k) {
      int const distance = detail::candidate_distance(w, kp, right_x, wanted, k, limit);
      if (distance >= 0 && distance < found.second && !taken(ctx.number(c, k), false)) {
        found.add(k, distance);
      }
    });
  }
};

/// Candidates and greedy assignment of a search, equal to the sequential loop for any input: fills
/// `frame.holder`, `work.match` and `work.matches`. Asynchronous on `exec`; allocates nothing; two
/// launches.
template <typename Exec>
void search_by_projection(Exec const& exec, frame_view const& frame, map_points_view const& map,
                          search_windows_view const& windows, search_params const& params,
                          search_workspace const& work) {
  for_each_item<per_warp>(exec, windows.batch * windows.capacity, list_candidates{}, frame, map,
                          windows, params, work);
  for_each_item<per_block<assign_threads>>(exec, windows.batch,
                                           assign_keypoints<Exec::asynchronous>{}, frame, map,
                                           windows, params, work);
}

// ---- search from the last frame
// -------------------------------------------------------------------

/// The frame before, as far as the search needs it: keypoints of both cameras of a fisheye pair,
/// left then right; of a rectified pair the left ones.
struct last_frame_view {
  soa_view<field::angle, field::octave> keypoints;
  int keypoint_step = 2;
  int cameras = 1;
  int const* holder =
      nullptr;  ///< [batch][cameras * capacity] slot of an inlier map point, -1 = none
};

struct last_search_params {
  float th = 7;         ///< window half side at scale 1, pixels
  bool mono = false;    ///< no direction of motion
  int retry_below = 0;  ///< with fewer matches the search is repeated with twice the radius
  bool orientation_check = true;  ///< drop matches whose rotation few others have
  bool reference_quirks =
      false;  ///< project into the right fisheye camera with the left one's model
  float min_x = 0, min_y = 0, max_x = 0, max_y = 0;  ///< image bounds, pixels, inclusive
};

/// Keypoints of the last frame, left ones then right ones without a gap: the order of the search.
FT_HOST_DEVICE inline int last_point_count(last_frame_view const& last, int b) {
  return last.keypoints.count[last.keypoint_step * b] +
         (last.cameras == 2 ? last.keypoints.count[last.keypoint_step * b + 1] : 0);
}

/// What all windows of a search from the last frame are made from.
template <typename Rig>
struct last_search {
  Rig rig;
  pose const* poses;       ///< [batch] T_cw predicted for this frame
  pose const* last_poses;  ///< [batch] T_cw of the last frame
  last_frame_view last;
  last_search_params params;
};

/// One keypoint of the last frame: the windows of its map point, and their candidates.
template <typename Rig>
struct list_last_point {
  using scratch = list_candidates::scratch;

  template <typename Group>
  FT_HOST_DEVICE void operator()(Group g, scratch& s, int item, last_search<Rig> const& search,
                                 frame_view const& frame, map_points_view const& map,
                                 pyramid_geometry const& geometry, search_params const& params,
                                 search_windows_view const& windows,
                                 search_workspace const& work) const {
    int const b = item / windows.capacity;
    int const i = item % windows.capacity;
    int const count = last_point_count(search.last, b);
    if (i == 0 && g.rank() == 0) { windows.count[b] = count; }
    if (i >= count) { return; }
    list(g, s, b, i, search, search.params.th, frame, map, geometry, params, windows, work);
  }

  /// Window i of batch entry b. @param th half side of a window at scale 1, pixels
  template <typename Group>
  FT_HOST_DEVICE static void list(Group g, scratch& s, int b, int i, last_search<Rig> const& search,
                                  float th, frame_view const& frame, map_points_view const& map,
                                  pyramid_geometry const& geometry, search_params const& params,
                                  search_windows_view const& windows,
                                  search_workspace const& work) {
    // All threads compute the same windows: quicker than waiting for one of them.
    window_pair const pair = project(b, i, search, th, map, geometry);
    if (g.rank() == 0) {
      windows.at(0, b, i) = pair.of[0];
      if constexpr (!Rig::rectified) { windows.at(1, b, i) = pair.of[1]; }
    }
    list_candidates::list(g, s, b, i, pair, frame, map, params, work);
  }

private:
  FT_HOST_DEVICE static window_pair project(int b, int i, last_search<Rig> const& search, float th,
                                            map_points_view const& map,
                                            pyramid_geometry const& geometry) {
    Rig const& rig = search.rig;
    last_frame_view const& last = search.last;
    last_search_params const& params = search.params;
    window_pair out;
    int const left_count = last.keypoints.count[last.keypoint_step * b];
    int const c_last = i < left_count ? 0 : 1;
    int const k = i < left_count ? i : i - left_count;
    int const number = c_last * last.keypoints.capacity + k;
    int const slot =
        last.holder[static_cast<std::ptrdiff_t>(b) * last.cameras * last.keypoints.capacity +
                    number];
    map_points_view const points = map.slice(b);
    if (slot < 0 || slot >= points.capacity) { return out; }

    auto const T_cw = search.poses[b].template cast<strict_float>();
    auto const T_lw = search.last_poses[b].template cast<strict_float>();
    vec3<float> const world = get<field::position>(points, slot);
    vec3<strict_float> const Pc = T_cw * vec3<strict_float>{world.x, world.y, world.z};
    strict_float const inv_z = strict_float(1.0f) / Pc.z;
    if (!(inv_z >= 0.0f)) { return out; }
    int const octave = get<field::octave>(last.keypoints.slice(last.keypoint_step * b + c_last), k);
    strict_float const baseline = rig.baseline_length();
    strict_float const ahead = (T_lw * T_cw.centre()).z;
    bool const forward = ahead > baseline && !params.mono;
    bool const backward = -ahead > baseline && !params.mono;

    search_window w{};
    w.radius = detail::mul(th, geometry.scale[octave]);
    w.min_level = forward ? octave : (backward ? 0 : octave - 1);
    w.max_level = forward ? -1 : (backward ? octave : octave + 1);
    w.slot = slot;
    if constexpr (Rig::rectified) {
      auto const seen = rig.camera.template cast<strict_float>().project(Pc);
      if (!in_bounds(seen, params)) { return out; }
      w.x = seen.pixel.x.value;
      w.y = seen.pixel.y.value;
      w.right_x = (seen.pixel.x - rig.bf * inv_z).value;
      w.check_right = true;
      out.of[0] = w;
    } else {
      auto const seen = rig.left.template cast<strict_float>().project(Pc);
      if (!in_bounds(seen, params)) { return out; }
      w.x = seen.pixel.x.value;
      w.y = seen.pixel.y.value;
      out.of[0] = w;
      vec3<strict_float> const Pr = rig.T_rl.template cast<strict_float>() * Pc;
      auto const right = project_right(rig, Pr, params.reference_quirks);
      if (!right.valid) { return out; }
      w.x = right.pixel.x.value;
      w.y = right.pixel.y.value;
      out.of[1] = w;
    }
    return out;
  }

  FT_HOST_DEVICE static bool in_bounds(projection<strict_float> const& p,
                                       last_search_params const& b) {
    return p.valid && p.pixel.x >= b.min_x && p.pixel.x <= b.max_x && p.pixel.y >= b.min_y &&
           p.pixel.y <= b.max_y;
  }
  FT_HOST_DEVICE static projection<strict_float> project_right(Rig const& rig, vec3<strict_float> p,
                                                               bool quirks) {
    if (quirks) { return rig.left.template cast<strict_float>().project(p); }
    return rig.right.template cast<strict_float>().project(p);
  }
};

/// How far keypoints turned from the last frame to this one, in bins of 30 degrees.
struct rotations {
  static constexpr int bins = 30;

  /// Angle of the keypoint of the last frame that window i is for. @param left_count of its
  /// keypoints are in the left image
  FT_HOST_DEVICE static float last_angle(last_frame_view const& last, int left_count, int b,
                                         int i) {
    bool const left = i < left_count;
    auto const from = last.keypoints.slice(last.keypoint_step * b + (left ? 0 : 1));
    return get<field::angle>(from, left ? i : i - left_count);
  }
  FT_HOST_DEVICE static int bin(float before, float now) {
    float rotation = before - now;
    if (rotation < 0.0f) { rotation += 360.0f; }
    int const r = round_away(detail::mul(rotation, 1.0f / static_cast<float>(bins)));
    return r == bins ? 0 : clamp(r, 0, bins - 1);
  }

  /// The three fullest bins, the lowest index winning a tie; those that are much emptier than the
  /// first do not count.
  struct most_frequent {
    int bin[3];   ///< -1 = none
    int matches;  ///< in all of them

    FT_HOST_DEVICE bool has(int r) const { return r == bin[0] || r == bin[1] || r == bin[2]; }
  };
  /// By all threads of each group that the block is made of: quicker than to wait for one of them.
  template <typename Part>
  FT_HOST_DEVICE static most_frequent of(Part w, int const* histogram) {
    most_frequent top{{-1, -1, -1}, 0};
    int first = 0;
    int below = 0x7fffffff;
    FT_UNROLL
    for (int t = 0; t < 3; ++t) {
      int best = 0;  // of keys (count, 31 - index)
      for (int i = w.rank(); i < bins; i += w.size()) {
        int const key = histogram[i] * 32 + 31 - i;
        if (histogram[i] > 0 && key < below) { best = max_of(best, key); }
      }
      below = w.reduce(best, max_op{});
      int const size = below / 32;
      if (t == 0) { first = size; }
      if (size == 0 || static_cast<float>(size) < detail::mul(0.1f, static_cast<float>(first))) {
        break;
      }
      top.bin[t] = 31 - below % 32;
      top.matches += size;
    }
    return top;
  }
};

/// One frame: drops the matches whose rotation is not among the three most frequent.
struct check_orientation {
  static constexpr int scratch_size = 4096;  ///< windows whose bins are kept
  struct scratch {
    int histogram[rotations::bins];
    std::uint8_t bin[scratch_size];
  };

  template <typename Group>
  FT_HOST_DEVICE void operator()(Group g, scratch& s, int b, frame_view const& frame,
                                 last_frame_view const& last, search_windows_view const& windows,
                                 search_workspace const& work) const {
    for (int i = g.rank(); i < rotations::bins; i += g.size()) { s.histogram[i] = 0; }
    g.sync();
    int const n = windows.count[b];
    int const left_count = last.keypoints.count[last.keypoint_step * b];
    bool const kept = frame.cameras * n <= scratch_size;
    constexpr std::uint8_t no_match = 255;
    auto const bin = [&](int c, int i, int k) {
      return rotations::bin(rotations::last_angle(last, left_count, b, i),
                            get<field::angle>(frame.camera(b, c), k));
    };
    for (int c = 0; c < frame.cameras; ++c) {
      for (int i = g.rank(); i < n; i += g.size()) {
        int const k = work.match[work.window(c, b, i)];
        int const r = k >= 0 ? bin(c, i, k) : no_match;
        if (k >= 0) { atomic_add(s.histogram + r, 1); }
        if (kept) { s.bin[c * n + i] = static_cast<std::uint8_t>(r); }
      }
    }
    g.sync();
    auto const most = rotations::of(g.part(), s.histogram);
    for (int c = 0; c < frame.cameras; ++c) {
      for (int i = g.rank(); i < n; i += g.size()) {
        if (kept && s.bin[c * n + i] == no_match) { continue; }
        int& k = work.match[work.window(c, b, i)];
        if (k < 0) { continue; }
        int const r = kept ? s.bin[c * n + i] : bin(c, i, k);
        if (most.has(r)) { continue; }
        frame.holder[static_cast<std::ptrdiff_t>(b) * frame.numbers() + c * frame.capacity() + k] =
            -1;
        k = -1;
      }
    }
    if (g.rank() == 0) { work.matches[b] = most.matches; }
  }
};

/// One frame: assignment, orientation check, the same again with twice the radius where there are
/// too few, stamps.
template <typename Rig, bool Turns>
struct assign_last_points {
  using assignment = assign_keypoints<Turns>;
  struct scratch {
    union {
      typename assignment::scratch assigned;
      list_candidates::scratch lists[assign_threads / 32];  ///< of the warps, for the second try
    };
    check_orientation::scratch orientation;
  };

  static constexpr bool prepares = true;
  template <typename Group, typename... Args>
  FT_HOST_DEVICE static void prepare(Group g, scratch& s, int b, last_search<Rig> const&,
                                     frame_view const& frame, Args const&...) {
    assignment::prepare(g, s.assigned, b, frame);
  }

  template <typename Group>
  FT_HOST_DEVICE void operator()(Group g, scratch& s, int b, last_search<Rig> const& search,
                                 frame_view const& frame, map_points_view const& map,
                                 pyramid_geometry const& geometry, search_params const& params,
                                 point_stamps const& stamps, search_windows_view const& windows,
                                 search_workspace const& work) const {
    // Asked for early: what depends on it comes after the proposals.
    int const left_count = search.last.keypoints.count[search.last.keypoint_step * b];
    int const now = stamps.seen != nullptr ? stamps.frame[b] : 0;
    auto const stamp = [&](int slot) {
      if (stamps.seen != nullptr) {
        stamps.seen[static_cast<std::ptrdiff_t>(b) * map.capacity + slot] = now;
      }
    };
    bool prepared = true;
    for (int least = search.params.retry_below;; least = 0) {
      // Before the assignment's first barrier.
      for (int i = g.rank(); i < rotations::bins; i += g.size()) { s.orientation.histogram[i] = 0; }
      bool enough = false;
      bool const written = assignment::assign(g, s.assigned, b, frame, map, windows, params, work,
                                              prepared, [&](auto single, int const* owners) {
                                                if constexpr (Turns) {
                                                  enough = write_owned<decltype(single)::value>(
                                                      g, s, b, search, left_count, frame, windows,
                                                      work, owners, least, stamp);
                                                }
                                                return Turns;
                                              });
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
  /// What is left of the matches after the orientation check; or, where these are fewer than
  /// `least`, nothing, and false. @param left_count as in rotations @param owners as in
  /// assign_keypoints
  template <bool Single, typename Group, typename Stamp>
  FT_HOST_DEVICE static bool write_owned(Group g, scratch& s, int b, last_search<Rig> const& search,
                                         int left_count, frame_view const& frame,
                                         search_windows_view const& windows,
                                         search_workspace const& work, int const* owners, int least,
                                         Stamp const& stamp) {
    int const numbers = frame.numbers();
    bool const any = windows.count[b] > 0;
    int* const slots = s.assigned.before;  // of the owners
    int* const histogram = s.orientation.histogram;
    struct owner {
      int slot;
      float before, now;  // angles
    };
    auto const camera_of = [&](int number) { return Single || number < frame.capacity() ? 0 : 1; };
    // For keypoints that nobody owns what window 0 has is loaded, and not used: no branches.
    detail::load_ahead<2>(
        g, any ? numbers : 0,
        [&](int number) {
          int const c = camera_of(number);
          bool const owned = owners[number] != assignment::nobody;
          int const i = owned ? owners[number] / assignment::list_size : 0;
          owner o;
          o.slot = windows.at(c, b, i).slot;
          o.before = rotations::last_angle(search.last, left_count, b, i);
          o.now = get<field::angle>(frame.camera(b, c), number - c * frame.capacity());
          return o;
        },
        [&](int number, owner const& o) {
          if (owners[number] == assignment::nobody) { return; }
          // Without the check all are in one bin.
          int const r = search.params.orientation_check ? rotations::bin(o.before, o.now) : 0;
          s.orientation.bin[number] = static_cast<std::uint8_t>(r);
          atomic_add(histogram + r, 1);
          slots[number] = o.slot;
        });
    g.sync();
    auto const most = rotations::of(g.part(), histogram);
    if (most.matches < least) { return false; }
    for (int number = g.rank(); number < numbers; number += g.size()) {
      bool const stays =
          owners[number] != assignment::nobody && most.has(s.orientation.bin[number]);
      int const slot = stays ? slots[number] : -1;
      frame.holder[static_cast<std::ptrdiff_t>(b) * numbers + number] = slot;
      if (!stays) { continue; }
      int const c = camera_of(number);
      work.match[work.window(c, b, owners[number] / assignment::list_size)] =
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

/// Empties the holders of a frame.
struct clear_holders {
  using scratch = no_scratch;

  template <typename Group>
  FT_HOST_DEVICE void operator()(Group, scratch&, int item, frame_view const& frame) const {
    frame.holder[item] = -1;
  }
};

/// Search from the last frame: windows, candidates, assignment, orientation check; from empty
/// holders. Asynchronous on `exec`; allocates nothing; two launches.
/// @param poses,last_poses [batch] T_cw predicted for this frame, and of the last one
/// @param exec may be beside() another launch: the second of these two is in turn
/// @param listed called with the executor between the two launches; what it queues there may be
/// what fills frame.right_x
template <typename Exec, typename Rig, typename Listed>
void search_last_frame(Exec const& exec, Rig const& rig, pose const* poses, pose const* last_poses,
                       frame_view const& frame, last_frame_view const& last,
                       map_points_view const& map, last_search_params const& params,
                       pyramid_geometry const& geometry, search_windows_view const& windows,
                       search_workspace const& work, point_stamps const& stamps,
                       Listed const& listed) {
  last_search<Rig> const input{rig, poses, last_poses, last, params};
  search_params search;
  search.kind = search_kind::last_frame;
  search.from_empty = true;
  search.right_later = true;
  for_each_item<per_warp>(exec, windows.batch * windows.capacity, list_last_point<Rig>{}, input,
                          frame, map, geometry, search, windows, work);
  listed(in_turn(exec));
  for_each_item<per_block<assign_threads>>(in_turn(exec), frame.batch,
                                           assign_last_points<Rig, Exec::asynchronous>{}, input,
                                           frame, map, geometry, search, stamps, windows, work);
}

/// The same with frame.right_x there from the start.
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
