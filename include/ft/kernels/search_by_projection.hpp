// SPDX-License-Identifier: Apache-2.0
/// @file Stage: search by projection, from the last frame and in the local map.
/// Source: specification sections 9 and 10.
///
/// The searches are sequential by definition: map points come in order, and a keypoint taken by one
/// is not there for the next. Here all points list their candidates at once; then, in rounds, every
/// point without an answer marks the keypoints it may take with its number, and a point whose
/// candidates carry no lower number has the same choice as in the sequential loop and makes it. The
/// lowest open point always does, so the rounds end; in practice a few are enough. (Deterministic
/// reservations: Blelloch, Fineman, Gibbons, Shun, "Internally deterministic parallel algorithms
/// can be fast", PPoPP 2012.)
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
};

/// Four candidates of a window, each distance << 23 | keypoint.
struct alignas(16) candidate_quad {
  std::uint32_t entry[4];
};

/// Candidates of one search and the state of the assignment.
struct search_workspace {
  static constexpr int list_size = 16;  ///< longer lists are walked in the grid again, none is cut
  candidate_quad* list = nullptr;  ///< [cameras][batch][capacity][list_size / 4], padded with ~0
  /// [cameras][batch][capacity], may exceed list_size; 0 where a window could take none of them
  int* list_count = nullptr;
  int* match = nullptr;  ///< [cameras][batch][capacity] keypoint taken by each window, -1 = none
  int* touch = nullptr;  ///< [batch][numbers] lowest open window that may take a keypoint
  std::uint8_t* settled = nullptr;  ///< [batch][numbers] 1 = taken for good
  int* open = nullptr;              ///< [2][batch][capacity] windows without an answer
  int* matches = nullptr;           ///< [batch] keypoints that were given a point
  int capacity = 0;                 ///< windows
  int batch = 0;
  int cameras = 1;

  FT_HOST_DEVICE std::ptrdiff_t window(int camera, int b, int i) const {
    return (static_cast<std::ptrdiff_t>(camera) * batch + b) * capacity + i;
  }
};

inline void carve(carver& c, search_workspace& v, int windows, int keypoints, int batch,
                  int cameras) {
  v.capacity = windows;
  v.batch = batch;
  v.cameras = cameras;
  std::size_t const b = static_cast<std::size_t>(batch);
  std::size_t const n = static_cast<std::size_t>(cameras) * b * static_cast<std::size_t>(windows);
  v.list = c.take<candidate_quad>(detail::checked_mul(n, search_workspace::list_size / 4));
  v.list_count = c.take<int>(n);
  v.match = c.take<int>(n);
  v.touch =
      c.take<int>(b * static_cast<std::size_t>(cameras) * static_cast<std::size_t>(keypoints));
  v.settled = c.take<std::uint8_t>(b * static_cast<std::size_t>(cameras) *
                                   static_cast<std::size_t>(keypoints));
  v.open = c.take<int>(detail::checked_mul(2 * b, static_cast<std::size_t>(windows)));
  v.matches = c.take<int>(b);
}

namespace detail {

/// Largest descriptor distance that can matter: to be taken, or to be second best.
FT_HOST_DEVICE inline int listed_distance(search_params const& p) {
  return p.kind == search_kind::local_map && p.ratio > 0
             ? max_of(
                   p.max_distance,
                   min_of(256, static_cast<int>(static_cast<float>(p.max_distance) / p.ratio) + 1))
             : p.max_distance;
}

/// Distance of keypoint k where it can be a candidate at all, else -1; whatever holds it.
FT_HOST_DEVICE inline int candidate_distance(search_window const& w, keypoints_view const& kp,
                                             float const* right_x, descriptor const& wanted, int k,
                                             int limit) {
  if (!inside(w, kp, k)) { return -1; }
  if (w.check_right && right_x != nullptr) {
    float const r = right_x[k];
    if (r > 0 && ::fabsf(w.right_x - r) > w.radius) { return -1; }
  }
  int const distance = hamming(wanted, get<field::orb>(kp, k));
  return distance <= limit ? distance : -1;
}

}  // namespace detail

/// One window (of both cameras): its candidates, in the grid's order.
struct list_candidates {
  using scratch = no_scratch;

  template <typename Group>
  FT_HOST_DEVICE void operator()(Group g, scratch&, int item, frame_view const& frame,
                                 map_points_view const& map, search_windows_view const& windows,
                                 search_params const& params, search_workspace const& work) const {
    int const b = item / windows.capacity;
    int const i = item % windows.capacity;
    if (i < windows.count[b]) { list(g, b, i, frame, map, windows, params, work); }
  }

  /// Window i of batch entry b.
  template <typename Group>
  FT_HOST_DEVICE static void list(Group g, int b, int i, frame_view const& frame,
                                  map_points_view const& map, search_windows_view const& windows,
                                  search_params const& params, search_workspace const& work) {
    map_points_view const points = map.slice(b);
    int const limit = detail::listed_distance(params);
    int const* const holder = frame.holder + static_cast<std::ptrdiff_t>(b) * frame.numbers();
    float const* const right_x =
        frame.right_x == nullptr
            ? nullptr
            : frame.right_x + static_cast<std::ptrdiff_t>(b) * frame.capacity();
    bool left_empty = false;
    for (int c = 0; c < frame.cameras; ++c) {
      search_window const w = windows.at(c, b, i);
      std::ptrdiff_t const at = work.window(c, b, i);
      candidate_quad* const list = work.list + at * (search_workspace::list_size / 4);
      int found = 0;
      int in_window = 0;
      int takeable = 0;
      if (w.slot >= 0 && !left_empty) {
        keypoints_view const kp = frame.camera(b, c);
        descriptor const wanted = get<field::orb>(points, w.slot);
        visit_cells(g, w, frame.grids.slice(frame.cameras * b + c), [&](int k) {
          int distance = -1;
          if (k >= 0) {
            // With one camera a keypoint that is taken stays taken.
            int const held = frame.cameras == 1 && !params.from_empty ? holder[k] : -1;
            if (held < 0 || get<field::observations>(points, held) <= 0) {
              distance =
                  detail::candidate_distance(w, kp, c == 0 ? right_x : nullptr, wanted, k, limit);
            }
            in_window += static_cast<int>(inside(w, kp, k));
          }
          int total = 0;
          int const place = found + g.exclusive_scan(static_cast<int>(distance >= 0), total);
          if (distance >= 0 && place < search_workspace::list_size) {
            list[place / 4].entry[place % 4] =
                static_cast<std::uint32_t>(distance) << 23 | static_cast<std::uint32_t>(k);
          }
          takeable |= static_cast<int>(distance >= 0 && distance <= params.max_distance);
          found += total;
        });
      }
      int const padded = min_of((found + 3) / 4 * 4, search_workspace::list_size);
      for (int place = found + g.rank(); place < padded; place += g.size()) {
        list[place / 4].entry[place % 4] = ~0u;
      }
      // A window that can take nothing decides nothing and influences nobody.
      takeable = g.reduce(takeable, max_op{});
      if (g.rank() == 0) { work.list_count[at] = takeable != 0 ? found : 0; }
      if (params.kind == search_kind::last_frame && frame.cameras == 2) {
        left_empty = g.reduce(in_window, sum_op{}) == 0;
      }
    }
  }
};

/// All windows of one frame: who takes which keypoint.
/// @tparam Rounds true: deterministic reservations; false: the plain loop, for groups of one thread
template <bool Rounds>
struct assign_keypoints {
  /// Frames of up to so many keypoints and windows keep the state of the rounds in block scratch,
  /// others in the workspace.
  static constexpr int scratch_size = 4096;
  struct rounds_scratch {
    int touch[scratch_size];
    std::uint8_t settled[scratch_size];
    std::uint16_t open[2][scratch_size];
    int left_open;
    int observed;  ///< 1 = every point looked for is observed, so that what is taken stays taken
  };
  struct scratch : std::conditional_t<Rounds, rounds_scratch, no_scratch> {};

  template <typename Group>
  FT_HOST_DEVICE void operator()(Group g, scratch& s, int b, frame_view const& frame,
                                 map_points_view const& map, search_windows_view const& windows,
                                 search_params const& params, search_workspace const& work) const {
    static_assert(Rounds || Group::max_threads == 1, "the plain loop is for one thread");
    context const ctx{b,
                      frame,
                      map.slice(b),
                      windows,
                      params,
                      work,
                      frame.holder + static_cast<std::ptrdiff_t>(b) * frame.numbers(),
                      frame.partner == nullptr
                          ? nullptr
                          : frame.partner + static_cast<std::ptrdiff_t>(b) * frame.numbers()};
    int const n = windows.count[b];
    int taken = 0;
    if (params.from_empty) {
      for (int k = g.rank(); k < frame.numbers(); k += g.size()) { ctx.holder[k] = -1; }
      g.sync();
    }
    if constexpr (!Rounds) {
      for (int i = 0; i < n; ++i) {
        taken += decide(ctx, i, [&](int k) { return occupied(ctx, k); });
      }
      work.matches[b] = taken;
    }
    if constexpr (Rounds) {
      taken = g.reduce(make_rounds(g, s, ctx, n), sum_op{});
      if (g.rank() == 0) { work.matches[b] = taken; }
    }
  }

private:
  struct context {
    int b;
    frame_view const& frame;
    map_points_view points;
    search_windows_view const& windows;
    search_params const& params;
    search_workspace const& work;
    int* holder;
    int const* partner;
  };

  /// Numbers of windows, in block scratch or in the workspace.
  struct window_list {
    std::uint16_t* narrow;
    int* wide;
    FT_HOST_DEVICE int get(int at) const { return narrow != nullptr ? narrow[at] : wide[at]; }
    FT_HOST_DEVICE void set(int at, int i) const {
      if (narrow != nullptr) {
        narrow[at] = static_cast<std::uint16_t>(i);
      } else {
        wide[at] = i;
      }
    }
  };

  /// State of the keypoints in the rounds.
  struct marks {
    int* touch;             ///< the lowest open window that may read or write it
    std::uint8_t* settled;  ///< 1 = taken, and stays so: who wants it need not wait
  };

  /// Deterministic reservations. Returns how many keypoints this thread has given away.
  template <typename Group>
  FT_HOST_DEVICE static int make_rounds(Group g, scratch& s, context const& ctx, int n) {
    int const numbers = ctx.frame.numbers();
    bool const narrow = n <= scratch_size;
    int* const wide = ctx.work.open + static_cast<std::ptrdiff_t>(ctx.b) * 2 * ctx.work.capacity;
    window_list open{narrow ? s.open[0] : nullptr, wide};
    window_list next{narrow ? s.open[1] : nullptr, wide + ctx.work.capacity};
    constexpr int untouched = 0x7fffffff;
    std::ptrdiff_t const first = static_cast<std::ptrdiff_t>(ctx.b) * numbers;
    marks const m = numbers <= scratch_size
                        ? marks{s.touch, s.settled}
                        : marks{ctx.work.touch + first, ctx.work.settled + first};
    if (g.rank() == 0) {
      s.left_open = 0;
      s.observed = 1;
    }
    for (int k = g.rank(); k < numbers; k += g.size()) { m.settled[k] = 0; }
    g.sync();
    for (int i = g.rank(); i < n; i += g.size()) {
      if (has_candidates(ctx, i)) {
        open.set(atomic_add(&s.left_open, 1), i);
        if (passes_on(ctx) && !is_observed(ctx, i)) { atomic_min(&s.observed, 0); }
      } else {
        clear_matches(ctx, i);
      }
    }
    g.sync();
    int count = s.left_open;
    g.sync();  // read by all before it is set anew
    // Where stereo partners are taken too, one that nobody has observed may take the place of one
    // that counts.
    bool const lasting = s.observed != 0 || !passes_on(ctx);
    int taken = 0;
    while (count > 0) {
      for (int k = g.rank(); k < numbers; k += g.size()) {
        m.touch[k] = untouched;
        if (lasting && m.settled[k] == 0) {
          m.settled[k] = static_cast<std::uint8_t>(occupied(ctx, k));
        }
      }
      if (g.rank() == 0) { s.left_open = 0; }
      g.sync();
      for (int at = g.rank(); at < count; at += g.size()) {
        int const i = open.get(at);
        for_each_touched(ctx, i, m, [&](int number) { atomic_min(m.touch + number, i); });
      }
      g.sync();
      for (int at = g.rank(); at < count; at += g.size()) {
        int const i = open.get(at);
        bool mine = true;
        for_each_touched(ctx, i, m, [&](int number) { mine = mine && m.touch[number] == i; });
        if (mine) {
          // On the left the marks say what is taken; on the right the window itself may just have
          // taken a partner.
          taken += decide(ctx, i, [&](int k) {
            return lasting && k < ctx.frame.capacity() ? m.settled[k] != 0 : occupied(ctx, k);
          });
        } else {
          next.set(atomic_add(&s.left_open, 1), i);
        }
      }
      g.sync();
      count = s.left_open;
      g.sync();
      window_list const turn = open;
      open = next;
      next = turn;
    }
    return taken;
  }

  /// Calls visit(keypoint, distance) for the candidates of window i in camera c, in order.
  template <typename Visit>
  FT_HOST_DEVICE static void for_each_candidate(context const& ctx, int c, int i,
                                                Visit const& visit) {
    std::ptrdiff_t const at = ctx.work.window(c, ctx.b, i);
    int const n = ctx.work.list_count[at];
    if (n > search_workspace::list_size) {
      for_each_listless_candidate(ctx, c, i, visit);
      return;
    }
    constexpr int quads = search_workspace::list_size / 4;
    FT_NO_UNROLL
    for (int q = 0; 4 * q < n; ++q) {
      candidate_quad const list = ctx.work.list[at * quads + q];
      FT_UNROLL
      for (int e = 0; e < 4; ++e) {
        std::uint32_t const entry = list.entry[e];
        if (4 * q + e < n) {
          visit(static_cast<int>(entry & 0x7fffffu), static_cast<int>(entry >> 23));
        }
      }
    }
  }

  /// The same for a window with more candidates than its list holds.
  template <typename Visit>
  FT_HOST_DEVICE static void for_each_listless_candidate(context const& ctx, int c, int i,
                                                         Visit const& visit) {
    search_window const w = ctx.windows.at(c, ctx.b, i);
    keypoints_view const kp = ctx.frame.camera(ctx.b, c);
    descriptor const wanted = get<field::orb>(ctx.points, w.slot);
    int const limit = detail::listed_distance(ctx.params);
    float const* const right_x =
        ctx.frame.right_x == nullptr || c != 0
            ? nullptr
            : ctx.frame.right_x + static_cast<std::ptrdiff_t>(ctx.b) * ctx.frame.capacity();
    visit_cells(single_group{}, w, ctx.frame.grids.slice(ctx.frame.cameras * ctx.b + c),
                [&](int k) {
                  int const distance = detail::candidate_distance(w, kp, right_x, wanted, k, limit);
                  if (distance >= 0) { visit(k, distance); }
                });
  }

  FT_HOST_DEVICE static bool has_candidates(context const& ctx, int i) {
    bool any = false;
    for (int c = 0; c < ctx.frame.cameras; ++c) {
      any = any || ctx.work.list_count[ctx.work.window(c, ctx.b, i)] > 0;
    }
    return any;
  }
  /// Whether the points that window i looks for are observed.
  FT_HOST_DEVICE static bool is_observed(context const& ctx, int i) {
    bool all = true;
    for (int c = 0; c < ctx.frame.cameras; ++c) {
      int const slot = ctx.windows.at(c, ctx.b, i).slot;
      all = all && (slot < 0 || get<field::observations>(ctx.points, slot) > 0);
    }
    return all;
  }
  FT_HOST_DEVICE static void clear_matches(context const& ctx, int i) {
    for (int c = 0; c < ctx.frame.cameras; ++c) {
      ctx.work.match[ctx.work.window(c, ctx.b, i)] = -1;
    }
  }

  FT_HOST_DEVICE static bool passes_on(context const& ctx) {
    return ctx.partner != nullptr && ctx.params.kind == search_kind::local_map;
  }

  /// Calls visit(number) for every keypoint whose state window i may wait for or change. What is
  /// settled is neither: it is taken whatever happens. Its holder may still change as the partner
  /// of another, and for the order of those who do that it counts.
  template <typename Visit>
  FT_HOST_DEVICE static void for_each_touched(context const& ctx, int i, marks const& m,
                                              Visit const& visit) {
    bool hopeful = false;
    for (int c = 0; c < ctx.frame.cameras; ++c) {
      for_each_candidate(ctx, c, i, [&](int k, int distance) {
        hopeful = hopeful || (distance <= ctx.params.max_distance &&
                              m.settled[c * ctx.frame.capacity() + k] == 0);
      });
    }
    if (!hopeful) { return; }  // takes nothing, whatever the others do
    for (int c = 0; c < ctx.frame.cameras; ++c) {
      for_each_candidate(ctx, c, i, [&](int k, int) {
        int const number = c * ctx.frame.capacity() + k;
        if (m.settled[number] != 0) { return; }
        visit(number);
        if (passes_on(ctx) && ctx.partner[number] >= 0) { visit(ctx.partner[number]); }
      });
    }
  }

  FT_HOST_DEVICE static bool occupied(context const& ctx, int number) {
    int const held = ctx.holder[number];
    return held >= 0 && get<field::observations>(ctx.points, held) > 0;
  }

  /// Window i's choice, given what all earlier windows took. Returns how many keypoints it was
  /// given. @param taken_for_good of a keypoint's number
  template <typename Taken>
  FT_HOST_DEVICE static int decide(context const& ctx, int i, Taken const& taken_for_good) {
    int taken = 0;
    bool refused = false;
    for (int c = 0; c < ctx.frame.cameras; ++c) {
      int& match = ctx.work.match[ctx.work.window(c, ctx.b, i)];
      match = -1;
      if (refused) { continue; }
      int best = 256;
      int second = 256;
      int best_k = -1;
      int second_k = -1;
      for_each_candidate(ctx, c, i, [&](int k, int distance) {
        if (distance >= second || taken_for_good(c * ctx.frame.capacity() + k)) { return; }
        if (distance < best) {
          second = best;
          second_k = best_k;
          best = distance;
          best_k = k;
        } else {
          second = distance;
          second_k = k;
        }
      });
      if (best_k < 0 || best > ctx.params.max_distance) { continue; }
      if (ctx.params.kind == search_kind::local_map && second_k >= 0 &&
          static_cast<float>(best) > detail::mul(ctx.params.ratio, static_cast<float>(second))) {
        keypoints_view const kp = ctx.frame.camera(ctx.b, c);
        if (get<field::octave>(kp, best_k) == get<field::octave>(kp, second_k)) {
          refused = c == 0;
          continue;
        }
      }
      int const number = c * ctx.frame.capacity() + best_k;
      int const slot = ctx.windows.at(c, ctx.b, i).slot;
      ctx.holder[number] = slot;
      match = best_k;
      ++taken;
      if (passes_on(ctx) && ctx.partner[number] >= 0) {
        ctx.holder[ctx.partner[number]] = slot;
        ++taken;
      }
    }
    return taken;
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
  for_each_item<per_block<512>>(exec, windows.batch, assign_keypoints<Exec::asynchronous>{}, frame,
                                map, windows, params, work);
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
  using scratch = no_scratch;

  template <typename Group>
  FT_HOST_DEVICE void operator()(Group g, scratch&, int item, last_search<Rig> const& search,
                                 frame_view const& frame, map_points_view const& map,
                                 pyramid_geometry const& geometry, search_params const& params,
                                 search_windows_view const& windows,
                                 search_workspace const& work) const {
    int const b = item / windows.capacity;
    int const i = item % windows.capacity;
    int const count = last_point_count(search.last, b);
    if (i == 0 && g.rank() == 0) { windows.count[b] = count; }
    if (i >= count) { return; }
    list(g, b, i, search, search.params.th, frame, map, geometry, params, windows, work);
  }

  /// Window i of batch entry b. @param th half side of a window at scale 1, pixels
  template <typename Group>
  FT_HOST_DEVICE static void list(Group g, int b, int i, last_search<Rig> const& search, float th,
                                  frame_view const& frame, map_points_view const& map,
                                  pyramid_geometry const& geometry, search_params const& params,
                                  search_windows_view const& windows,
                                  search_workspace const& work) {
    if (g.rank() == 0) { project(b, i, search, th, map, geometry, windows); }
    g.sync();
    list_candidates::list(g, b, i, frame, map, windows, params, work);
  }

private:
  FT_HOST_DEVICE static void project(int b, int i, last_search<Rig> const& search, float th,
                                     map_points_view const& map, pyramid_geometry const& geometry,
                                     search_windows_view const& out) {
    Rig const& rig = search.rig;
    last_frame_view const& last = search.last;
    last_search_params const& params = search.params;
    std::ptrdiff_t const item = static_cast<std::ptrdiff_t>(b) * out.capacity + i;
    int const left_count = last.keypoints.count[last.keypoint_step * b];
    int const c_last = i < left_count ? 0 : 1;
    int const k = i < left_count ? i : i - left_count;
    int const number = c_last * last.keypoints.capacity + k;
    int const slot =
        last.holder[static_cast<std::ptrdiff_t>(b) * last.cameras * last.keypoints.capacity +
                    number];
    constexpr int cameras = Rig::rectified ? 1 : 2;
    for (int c = 0; c < cameras; ++c) { at(out, c, item) = search_window::none(); }
    map_points_view const points = map.slice(b);
    if (slot < 0 || slot >= points.capacity) { return; }

    auto const T_cw = search.poses[b].template cast<strict_float>();
    auto const T_lw = search.last_poses[b].template cast<strict_float>();
    vec3<float> const world = get<field::position>(points, slot);
    vec3<strict_float> const Pc = T_cw * vec3<strict_float>{world.x, world.y, world.z};
    strict_float const inv_z = strict_float(1.0f) / Pc.z;
    if (!(inv_z >= 0.0f)) { return; }
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
      if (!in_bounds(seen, params)) { return; }
      w.x = seen.pixel.x.value;
      w.y = seen.pixel.y.value;
      w.right_x = (seen.pixel.x - rig.bf * inv_z).value;
      w.check_right = true;
      at(out, 0, item) = w;
    } else {
      auto const seen = rig.left.template cast<strict_float>().project(Pc);
      if (!in_bounds(seen, params)) { return; }
      w.x = seen.pixel.x.value;
      w.y = seen.pixel.y.value;
      at(out, 0, item) = w;
      vec3<strict_float> const Pr = rig.T_rl.template cast<strict_float>() * Pc;
      auto const right = project_right(rig, Pr, params.reference_quirks);
      if (!right.valid) { return; }
      w.x = right.pixel.x.value;
      w.y = right.pixel.y.value;
      at(out, 1, item) = w;
    }
  }

  FT_HOST_DEVICE static search_window& at(search_windows_view const& out, int camera,
                                          std::ptrdiff_t item) {
    return out.windows[static_cast<std::ptrdiff_t>(camera) * out.batch * out.capacity + item];
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

/// One frame: drops the matches whose rotation is not among the three most frequent.
struct check_orientation {
  static constexpr int bins = 30;
  static constexpr int scratch_size = 4096;  ///< windows whose bins are kept
  struct scratch {
    int histogram[bins];
    int top[3];
    std::uint8_t bin[scratch_size];
  };

  template <typename Group>
  FT_HOST_DEVICE void operator()(Group g, scratch& s, int b, frame_view const& frame,
                                 last_frame_view const& last, search_windows_view const& windows,
                                 search_workspace const& work) const {
    for (int i = g.rank(); i < bins; i += g.size()) { s.histogram[i] = 0; }
    g.sync();
    int const n = windows.count[b];
    bool const kept = frame.cameras * n <= scratch_size;
    constexpr std::uint8_t no_match = 255;
    for (int c = 0; c < frame.cameras; ++c) {
      for (int i = g.rank(); i < n; i += g.size()) {
        int const k = work.match[work.window(c, b, i)];
        int const r = k >= 0 ? bin(frame, last, b, c, i, k) : no_match;
        if (k >= 0) { atomic_add(s.histogram + r, 1); }
        if (kept) { s.bin[c * n + i] = static_cast<std::uint8_t>(r); }
      }
    }
    g.sync();
    // The three fullest, the lowest index winning a tie: keys (count, 31 - index).
    if (g.part_index() == 0) {
      auto const w = g.part();
      int below = 0x7fffffff;
      for (int t = 0; t < 3; ++t) {
        int best = 0;
        for (int i = w.rank(); i < bins; i += w.size()) {
          int const key = s.histogram[i] * 32 + 31 - i;
          if (s.histogram[i] > 0 && key < below) { best = max_of(best, key); }
        }
        best = w.reduce(best, max_op{});
        if (w.rank() == 0) { s.top[t] = best; }
        below = best;
      }
    }
    g.sync();
    int top[3];
    int size[3];
    for (int t = 0; t < 3; ++t) {
      top[t] = s.top[t] > 0 ? 31 - s.top[t] % 32 : -1;
      size[t] = s.top[t] / 32;
    }
    float const least = detail::mul(0.1f, static_cast<float>(size[0]));
    if (static_cast<float>(size[1]) < least) {
      top[1] = top[2] = -1;
    } else if (static_cast<float>(size[2]) < least) {
      top[2] = -1;
    }
    int dropped = 0;
    for (int c = 0; c < frame.cameras; ++c) {
      for (int i = g.rank(); i < n; i += g.size()) {
        if (kept && s.bin[c * n + i] == no_match) { continue; }
        int& k = work.match[work.window(c, b, i)];
        if (k < 0) { continue; }
        int const r = kept ? s.bin[c * n + i] : bin(frame, last, b, c, i, k);
        if (r != top[0] && r != top[1] && r != top[2]) {
          frame
              .holder[static_cast<std::ptrdiff_t>(b) * frame.numbers() + c * frame.capacity() + k] =
              -1;
          k = -1;
          ++dropped;
        }
      }
    }
    dropped = g.reduce(dropped, sum_op{});
    if (g.rank() == 0) { work.matches[b] -= dropped; }
  }

private:
  FT_HOST_DEVICE static int bin(frame_view const& frame, last_frame_view const& last, int b, int c,
                                int i, int k) {
    int const left_count = last.keypoints.count[last.keypoint_step * b];
    auto const from = last.keypoints.slice(last.keypoint_step * b + (i < left_count ? 0 : 1));
    float rotation = get<field::angle>(from, i < left_count ? i : i - left_count) -
                     get<field::angle>(frame.camera(b, c), k);
    if (rotation < 0.0f) { rotation += 360.0f; }
    int const r = round_away(detail::mul(rotation, 1.0f / static_cast<float>(bins)));
    return r == bins ? 0 : clamp(r, 0, bins - 1);
  }
};

/// Which map points were seen in which frame: written after a search, so that the next leaves them
/// out.
struct point_stamps {
  int const* frame = nullptr;  ///< [batch] number of this frame
  int* seen = nullptr;         ///< [batch][map slots] number of the frame that held a point last
};

/// One frame: assignment, orientation check, the same again with twice the radius where there are
/// too few, stamps.
template <typename Rig, bool Rounds>
struct assign_last_points {
  struct scratch {
    typename assign_keypoints<Rounds>::scratch assignment;
    check_orientation::scratch orientation;
  };

  template <typename Group>
  FT_HOST_DEVICE void operator()(Group g, scratch& s, int b, last_search<Rig> const& search,
                                 frame_view const& frame, map_points_view const& map,
                                 pyramid_geometry const& geometry, search_params const& params,
                                 point_stamps const& stamps, search_windows_view const& windows,
                                 search_workspace const& work) const {
    for (int attempt = 0;; ++attempt) {
      assign_keypoints<Rounds>{}(g, s.assignment, b, frame, map, windows, params, work);
      g.sync();
      if (search.params.orientation_check) {
        check_orientation{}(g, s.orientation, b, frame, search.last, windows, work);
        g.sync();
      }
      if (attempt == 1 || work.matches[b] >= search.params.retry_below) { break; }
      list_wider(g, b, search, frame, map, geometry, params, windows, work);
      g.sync();
    }
    if (stamps.seen == nullptr) { return; }
    int const* const holder = frame.holder + static_cast<std::ptrdiff_t>(b) * frame.numbers();
    for (int k = g.rank(); k < frame.numbers(); k += g.size()) {
      if (holder[k] >= 0) {
        stamps.seen[static_cast<std::ptrdiff_t>(b) * map.capacity + holder[k]] = stamps.frame[b];
      }
    }
  }

private:
  template <typename Group>
  FT_HOST_DEVICE static void list_wider(Group g, int b, last_search<Rig> const& search,
                                        frame_view const& frame, map_points_view const& map,
                                        pyramid_geometry const& geometry,
                                        search_params const& params,
                                        search_windows_view const& windows,
                                        search_workspace const& work) {
    int const count = windows.count[b];
    for (int i = g.part_index(); i < count; i += g.parts()) {
      list_last_point<Rig>::list(g.part(), b, i, search, 2 * search.params.th, frame, map, geometry,
                                 params, windows, work);
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
template <typename Exec, typename Rig>
void search_last_frame(Exec const& exec, Rig const& rig, pose const* poses, pose const* last_poses,
                       frame_view const& frame, last_frame_view const& last,
                       map_points_view const& map, last_search_params const& params,
                       pyramid_geometry const& geometry, search_windows_view const& windows,
                       search_workspace const& work, point_stamps const& stamps = {}) {
  last_search<Rig> const input{rig, poses, last_poses, last, params};
  search_params search;
  search.kind = search_kind::last_frame;
  search.from_empty = true;
  for_each_item<per_warp>(exec, windows.batch * windows.capacity, list_last_point<Rig>{}, input,
                          frame, map, geometry, search, windows, work);
  for_each_item<per_block<512>>(exec, frame.batch, assign_last_points<Rig, Exec::asynchronous>{},
                                input, frame, map, geometry, search, stamps, windows, work);
}

}  // namespace FT_ABI
}  // namespace ft
