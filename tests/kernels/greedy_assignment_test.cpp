// SPDX-License-Identifier: Apache-2.0
// Searches by projection are sequential by definition: sections 9 and 10 of the specification. The
// oracle below is that loop, told from the specification alone, over all keypoints of a frame. Both
// ways in which ft assigns keypoints, the plain one and the reservation rounds, must give its
// answer for any input.
#include <gtest/gtest.h>

#include <algorithm>
#include <bitset>
#include <cmath>
#include <cstdint>
#include <memory>
#include <numeric>
#include <random>
#include <string>
#include <tuple>
#include <vector>

#include "ft/cameras/stereo_rig.hpp"
#include "ft/containers/feature_grid.hpp"
#include "ft/containers/frame.hpp"
#include "ft/containers/image_pyramid.hpp"
#include "ft/containers/keypoints.hpp"
#include "ft/containers/map_points.hpp"
#include "ft/kernels/grid.hpp"
#include "ft/kernels/search/assignment.hpp"
#include "ft/kernels/search/last_frame.hpp"
#include "ft/kernels/search/workspace.hpp"
#include "tests/support/backends.hpp"
#include "tests/support/random.hpp"

namespace greedy_assignment {

using test::at;
using test::generator;

constexpr int poison = 0x55555555;  ///< what outputs hold before a search

/// Everything that a search reads. Arrays are laid out as the library's.
struct scene {
  int batch = 1;
  int cameras = 1;
  int step = 1;      ///< images per batch entry
  int capacity = 0;  ///< keypoints of an image
  int slots = 0;     ///< map points of a batch entry
  int windows = 0;   ///< of a batch entry and camera
  int spare = 0;     ///< by how much the workspace is larger than it need be
  ft::grid_geometry geometry;
  std::vector<float> x, y;  ///< [step * batch][capacity]
  std::vector<int> octave;
  std::vector<ft::descriptor> orb;
  std::vector<int> count;                 ///< [step * batch]
  std::vector<ft::descriptor> wanted;     ///< [batch][slots]
  std::vector<int> observations;          ///< [batch][slots]
  std::vector<ft::search_window> window;  ///< [cameras][batch][windows]
  std::vector<int> window_count;          ///< [batch]
  std::vector<float> right_x;             ///< [batch][capacity], or empty
  std::vector<int> partner;               ///< [batch][cameras * capacity], or empty
  std::vector<int> holder;                ///< [batch][cameras * capacity]
  ft::search_params params;
  /// Where the matches are checked for their rotation: angles in degrees; window i is that of left
  /// keypoint i of the last frame or, from `last_left` on, of right keypoint i - last_left.
  bool turned = false;
  std::vector<float> angle;       ///< [step * batch][capacity]
  std::vector<float> last_angle;  ///< [batch][2][windows]
  std::vector<int> last_left;     ///< [batch]

  int numbers() const { return cameras * capacity; }
  int image(int b, int c) const { return step * b + c; }
};

struct outcome {
  std::vector<int> holder;   ///< [batch][cameras * capacity]
  std::vector<int> match;    ///< [cameras][batch][windows]
  std::vector<int> matches;  ///< [batch]
  std::vector<int> lists;    ///< [cameras][batch][windows] of ft alone: counts and flags
};

/// How often the oracle met what the scenes are made for.
struct tally {
  long frames = 0;
  long windows = 0;
  long taken = 0;
  long long_lists = 0;         ///< windows with more candidates than a list holds
  long blocked = 0;            ///< best keypoint held by a point of this very search
  long retaken = 0;            ///< a keypoint taken from a point without observations
  long refused_left = 0;       ///< by the ratio test, where a right window follows
  long partner_overrun = 0;    ///< a partner taken although it held another point
  long outside_column = 0;     ///< kept out by the right column
  long equal_distances = 0;    ///< the first of equals was taken
  long right_not_reached = 0;  ///< last frame: nothing in the left window
  long freed = 0;  ///< held by an observed point before the search, and taken in it all the same
  // Windows of ft's lists with candidates left out since they are held: all of them, beside more
  // than a list holds, beside none that is listed, for points with and without observations.
  long left_out = 0;
  long left_out_of_long = 0;
  long left_out_alone = 0;
  long left_out_of_observed = 0;
  long left_out_of_guests = 0;
  long dropped = 0;         ///< matches for their rotation
  long returned_alone = 0;  ///< with none that is listed, one that was left out was taken
};

// ---- the sequential loop ----------------------------------------------------------------------

int bit_distance(ft::descriptor const& a, ft::descriptor const& b) {
  int distance = 0;
  for (int i = 0; i < 8; ++i) {
    distance += static_cast<int>(std::bitset<32>(a.words[i] ^ b.words[i]).count());
  }
  return distance;
}

/// Column and row of each keypoint's cell.
std::vector<ft::vec2<float>> cells_of(scene const& s) {
  auto const& g = s.geometry;
  std::vector<ft::vec2<float>> cells(s.x.size());
  for (std::size_t image = 0; image < s.count.size(); ++image) {
    for (int k = 0; k < s.count[image]; ++k) {
      std::size_t const i = image * at(s.capacity) + at(k);
      cells[i] = {std::round((s.x[i] - g.min_x) * g.inv_width),
                  std::round((s.y[i] - g.min_y) * g.inv_height)};
    }
  }
  return cells;
}

/// Keypoints of an image inside a window, in the order of an area query: section 7, over all
/// keypoints. @param cells of the scene
std::vector<int> keypoints_in_area(scene const& s, std::vector<ft::vec2<float>> const& cells,
                                   int image, ft::search_window const& w) {
  auto const& g = s.geometry;
  auto const clamped = [](float v, float low, float high) {
    return static_cast<int>(std::min(std::max(v, low), high));
  };
  auto const cols = static_cast<float>(g.cols);
  auto const rows = static_cast<float>(g.rows);
  float const x0 = std::floor((w.x - g.min_x - w.radius) * g.inv_width);
  float const x1 = std::ceil((w.x - g.min_x + w.radius) * g.inv_width);
  float const y0 = std::floor((w.y - g.min_y - w.radius) * g.inv_height);
  float const y1 = std::ceil((w.y - g.min_y + w.radius) * g.inv_height);
  if (x0 >= cols || x1 < 0 || y0 >= rows || y1 < 0) { return {}; }
  int const cx0 = clamped(x0, 0, cols);
  int const cx1 = clamped(x1, 0, cols - 1);
  int const cy0 = clamped(y0, 0, rows);
  int const cy1 = clamped(y1, 0, rows - 1);
  bool const check_level = w.min_level > 0 || w.max_level >= 0;
  std::vector<std::tuple<int, int, int>> found;
  for (int k = 0; k < s.count[at(image)]; ++k) {
    auto const i = at(static_cast<std::ptrdiff_t>(image) * s.capacity + k);
    if (!(std::fabs(s.x[i] - w.x) < w.radius && std::fabs(s.y[i] - w.y) < w.radius)) { continue; }
    if (check_level &&
        (s.octave[i] < w.min_level || (w.max_level >= 0 && s.octave[i] > w.max_level))) {
      continue;
    }
    int const cx = static_cast<int>(cells[i].x);
    int const cy = static_cast<int>(cells[i].y);
    bool const inside = cx >= cx0 && cx <= cx1 && cy >= cy0 && cy <= cy1;
    if (inside && cx < g.cols && cy < g.rows) { found.emplace_back(cx, cy, k); }
  }
  std::sort(found.begin(), found.end());
  std::vector<int> keypoints;
  for (auto const& f : found) { keypoints.push_back(std::get<2>(f)); }
  return keypoints;
}

/// Whether an observed point holds a keypoint of batch entry b when the search begins.
bool held_before(scene const& s, int b, int number) {
  int const held = s.holder[at(static_cast<std::ptrdiff_t>(b) * s.numbers() + number)];
  return !s.params.from_empty && held >= 0 &&
         s.observations[at(static_cast<std::ptrdiff_t>(b) * s.slots + held)] > 0;
}

/// Section 9, the end: keeps the matches in the three fullest of 30 bins of rotations.
void drop_turned(scene const& s, int b, outcome& out, tally& seen) {
  auto const window = [&](int c, int i) {
    return at((static_cast<std::ptrdiff_t>(c) * s.batch + b) * s.windows + i);
  };
  auto const bin = [&](int c, int i, int k) {
    int const left = s.last_left[at(b)];
    int const from = i < left ? i : s.windows + i - left;
    float rotation = s.last_angle[at(2 * static_cast<std::ptrdiff_t>(b) * s.windows + from)] -
                     s.angle[at(static_cast<std::ptrdiff_t>(s.image(b, c)) * s.capacity + k)];
    if (rotation < 0) { rotation += 360; }
    int const r = static_cast<int>(std::round(rotation * (1.0f / 30.0f)));
    return r == 30 ? 0 : r;
  };
  std::vector<int> sizes(30, 0);
  for (int c = 0; c < s.cameras; ++c) {
    for (int i = 0; i < s.window_count[at(b)]; ++i) {
      if (out.match[window(c, i)] >= 0) { ++sizes[at(bin(c, i, out.match[window(c, i)]))]; }
    }
  }
  std::vector<int> order(30);
  std::iota(order.begin(), order.end(), 0);
  std::stable_sort(order.begin(), order.end(),
                   [&](int a, int other) { return sizes[at(a)] > sizes[at(other)]; });
  std::vector<bool> keep(30, false);
  auto const fullest = static_cast<float>(sizes[at(order[0])]);
  for (std::size_t t = 0; t < 3; ++t) {
    if (static_cast<float>(sizes[at(order[t])]) < 0.1f * fullest) { break; }
    keep[at(order[t])] = true;
  }
  for (int c = 0; c < s.cameras; ++c) {
    for (int i = 0; i < s.window_count[at(b)]; ++i) {
      int& k = out.match[window(c, i)];
      if (k < 0 || keep[at(bin(c, i, k))]) { continue; }
      out.holder[at(static_cast<std::ptrdiff_t>(b) * s.numbers() + c * s.capacity + k)] = -1;
      k = -1;
      --out.matches[at(b)];
      ++seen.dropped;
    }
  }
}

/// Sections 9 and 10, map point after map point.
outcome search_in_order(scene const& s, tally& seen) {
  outcome out{s.holder,
              std::vector<int>(s.window.size(), poison),
              std::vector<int>(at(s.batch), poison),
              {}};
  bool const local = s.params.kind == ft::search_kind::local_map;
  auto const cells = cells_of(s);
  for (int b = 0; b < s.batch; ++b) {
    ++seen.frames;
    int* const holder = out.holder.data() + static_cast<std::ptrdiff_t>(b) * s.numbers();
    int const* const observations =
        s.observations.data() + static_cast<std::ptrdiff_t>(b) * s.slots;
    int const* const partner =
        s.partner.empty() ? nullptr
                          : s.partner.data() + static_cast<std::ptrdiff_t>(b) * s.numbers();
    if (s.params.from_empty) { std::fill(holder, holder + s.numbers(), -1); }
    int taken = 0;
    for (int i = 0; i < s.window_count[at(b)]; ++i) {
      bool search_right = true;
      for (int c = 0; c < s.cameras; ++c) {
        auto const number = at((static_cast<std::ptrdiff_t>(c) * s.batch + b) * s.windows + i);
        out.match[number] = -1;
        ft::search_window const& w = s.window[number];
        if (c == 1 && !search_right) { continue; }
        if (w.slot < 0) {
          if (!local) { search_right = false; }  // the left projection was out of bounds
          continue;
        }
        ++seen.windows;
        int const image = s.image(b, c);
        auto const area = keypoints_in_area(s, cells, image, w);
        if (!local && c == 0 && area.empty()) {
          search_right = false;
          seen.right_not_reached += static_cast<long>(s.cameras == 2);
        }
        ft::descriptor const& wanted =
            s.wanted[at(static_cast<std::ptrdiff_t>(b) * s.slots + w.slot)];
        int best = 256, second = 256, best_octave = -1, second_octave = -1, best_k = -1,
            best_blocked = 256;
        int candidates = 0;
        for (int const k : area) {
          auto const j = at(static_cast<std::ptrdiff_t>(image) * s.capacity + k);
          int const distance = bit_distance(wanted, s.orb[j]);
          int const held = holder[c * s.capacity + k];
          if (c == 0 && !s.right_x.empty() && w.check_right) {
            float const right = s.right_x[at(static_cast<std::ptrdiff_t>(b) * s.capacity + k)];
            if (right > 0 && std::fabs(w.right_x - right) > w.radius) {
              ++seen.outside_column;
              continue;
            }
          }
          candidates += static_cast<int>(distance <= s.params.max_hamming);
          if (held >= 0 && observations[held] > 0) {
            best_blocked = std::min(best_blocked, distance);
            continue;
          }
          if (distance < best) {
            second = best;
            second_octave = best_octave;
            best = distance;
            best_octave = s.octave[j];
            best_k = k;
          } else if (distance < second) {
            second = distance;
            second_octave = s.octave[j];
          }
        }
        seen.long_lists += static_cast<long>(candidates > ft::search_workspace::list_size);
        seen.blocked +=
            static_cast<long>(best_blocked < best && best_blocked <= s.params.max_hamming);
        if (best_k < 0 || best > s.params.max_hamming) { continue; }
        if (local && best_octave == second_octave &&
            static_cast<float>(best) > s.params.ratio * static_cast<float>(second)) {
          if (c == 0) {
            search_right = false;
            seen.refused_left += static_cast<long>(s.cameras == 2);
          }
          continue;
        }
        int const k = c * s.capacity + best_k;
        seen.retaken += static_cast<long>(holder[k] >= 0);
        seen.freed += static_cast<long>(held_before(s, b, k));
        seen.equal_distances += static_cast<long>(best == second);
        holder[k] = w.slot;
        out.match[number] = best_k;
        ++taken;
        if (local && partner != nullptr && partner[k] >= 0) {
          int& other = holder[partner[k]];
          seen.partner_overrun +=
              static_cast<long>(other >= 0 && other != w.slot && observations[other] > 0);
          other = w.slot;
          ++taken;
        }
      }
    }
    out.matches[at(b)] = taken;
    seen.taken += taken;
    if (s.turned) { drop_turned(s, b, out, seen); }
  }
  return out;
}

// ---- ft ---------------------------------------------------------------------------------------

/// Lists candidates before it is known which keypoints are held.
struct list_then_leave_out {
  using scratch = ft::detail::list_candidates::scratch;

  template <typename Group>
  FT_HOST_DEVICE bool prologue(Group g, scratch& s, int item, ft::frame_view const& frame,
                               ft::map_points_view const& map, ft::search_params const& params,
                               ft::search_buffers const& buffers) const {
    int const b = item / buffers.windows.capacity;
    int const i = item % buffers.windows.capacity;
    if (i >= buffers.windows.count[b]) { return false; }
    ft::frame_view const unheld = without_holders(frame);
    ft::detail::frame_search const in{b, unheld, map, params, buffers, true};
    ft::detail::list_candidates::list_all(g, s, in, buffers.windows.pair(b, i));
    return true;
  }
  template <typename Group>
  FT_HOST_DEVICE void operator()(Group g, scratch& s, int item, ft::frame_view const& frame,
                                 ft::map_points_view const& map, ft::search_params const& params,
                                 ft::search_buffers const& buffers) const {
    int const b = item / buffers.windows.capacity;
    ft::detail::frame_search const in{b, frame, map, params, buffers, true};
    ft::detail::list_candidates::write_free(g, s, in, item % buffers.windows.capacity,
                                            ft::detail::list_candidates::held(g, s, in));
  }

private:
  FT_HOST_DEVICE static ft::frame_view without_holders(ft::frame_view frame) {
    frame.holder = nullptr;
    return frame;
  }
};

/// The same search by ft. @tparam Way with `rounds`, reservation rounds or the plain loop, and
/// `early`, candidates of the local map listed before it is known who holds what
template <typename Way, typename Exec>
outcome search(Exec const& exec, scene const& s) {
  constexpr bool Rounds = Way::rounds;
  ft::keypoints<ft::memory_space::host> host_keypoints(s.capacity, s.step * s.batch);
  auto const kp = host_keypoints.view();
  std::copy(s.x.begin(), s.x.end(), ft::array_of<ft::field::x>(kp));
  std::copy(s.y.begin(), s.y.end(), ft::array_of<ft::field::y>(kp));
  std::copy(s.octave.begin(), s.octave.end(), ft::array_of<ft::field::octave>(kp));
  std::copy(s.orb.begin(), s.orb.end(), ft::array_of<ft::field::orb>(kp));
  std::copy(s.count.begin(), s.count.end(), kp.count);

  ft::keypoints_view keypoints;
  ft::map_points_view map;
  ft::feature_grid_view grids;
  ft::search_windows_view windows;
  ft::search_workspace work;
  ft::soa_view<ft::field::angle, ft::field::octave> last;
  float* right_x = nullptr;
  int* partner = nullptr;
  int* holder = nullptr;
  ft::arena<Exec::space> memory([&](ft::carver& c) {
    ft::carve(c, keypoints, s.capacity, s.step * s.batch);
    ft::carve(c, map, s.slots, s.batch);
    ft::carve(c, grids, s.geometry, s.capacity, s.cameras * s.batch);
    ft::carve(c, windows, s.windows, s.batch, s.cameras);
    ft::carve(c, work, s.windows + s.spare, s.capacity, s.batch, s.cameras);
    ft::carve(c, last, s.windows, 2 * s.batch);
    right_x = c.take<float>(s.right_x.size());
    partner = c.take<int>(s.partner.size());
    holder = c.take<int>(s.holder.size());
  });
  ft::fill_bytes(exec, memory.data(), poison & 0xff, memory.bytes());
  auto const put = [&](auto* to, auto const& values) {
    ft::copy(exec, to, values.data(), values.size());
  };
  ft::copy(exec, keypoints, kp);
  put(ft::array_of<ft::field::orb>(map), s.wanted);
  put(ft::array_of<ft::field::observations>(map), s.observations);
  put(windows.windows, s.window);
  put(windows.count, s.window_count);
  put(right_x, s.right_x);
  put(partner, s.partner);
  put(holder, s.holder);
  std::vector<int> last_count;  // lives until the copies are done
  if (s.turned) {
    put(ft::array_of<ft::field::angle>(keypoints), s.angle);
    put(ft::array_of<ft::field::angle>(last), s.last_angle);
    for (int b = 0; b < s.batch; ++b) {
      last_count.push_back(s.last_left[at(b)]);
      last_count.push_back(s.window_count[at(b)] - s.last_left[at(b)]);
    }
    put(last.count, last_count);
  }

  ft::frame_view frame;
  frame.keypoints = keypoints;
  frame.keypoint_step = s.step;
  frame.cameras = s.cameras;
  frame.batch = s.batch;
  frame.grids = grids;
  frame.right_x = s.right_x.empty() ? nullptr : right_x;
  frame.partner = s.partner.empty() ? nullptr : partner;
  frame.holder = holder;

  ft::search_buffers const buffers{windows, work};
  bool const all_images = s.cameras == s.step;
  ft::build_grid<ft::nearest_cell>(exec, keypoints, 0, all_images ? 1 : s.step, s.cameras * s.batch,
                                   grids);
  if (s.turned) {
    ft::last_search<ft::rectified_rig> search;  // only the last frame and max_hamming are used
    search.last.keypoints = last;
    search.last.cameras = s.cameras;
    search.params.max_hamming = s.params.max_hamming;
    ft::for_each_item<ft::per_warp>(exec, windows.batch * windows.capacity,
                                    ft::detail::list_candidates{}, frame, map, s.params, buffers);
    ft::for_each_item<ft::per_block<ft::detail::assign_threads>>(
        exec, windows.batch, ft::detail::assign_last_points<ft::rectified_rig, Rounds>{}, search,
        frame, map, buffers);
  } else if (Way::early && s.params.kind == ft::search_kind::local_map && !s.params.from_empty) {
    ft::for_each_item<ft::per_warp>(exec, windows.batch * windows.capacity, list_then_leave_out{},
                                    frame, map, s.params, buffers);
    ft::for_each_item<ft::per_block<ft::detail::assign_threads>>(
        exec, windows.batch, ft::detail::assign_keypoints<Rounds>{}, frame, map, s.params, buffers);
  } else if constexpr (Rounds == Exec::asynchronous) {
    ft::search_by_projection(exec, frame, map, s.params, buffers);
  } else {
    ft::for_each_item<ft::per_warp>(exec, windows.batch * windows.capacity,
                                    ft::detail::list_candidates{}, frame, map, s.params, buffers);
    ft::for_each_item<ft::per_block<ft::detail::assign_threads>>(
        exec, windows.batch, ft::detail::assign_keypoints<Rounds>{}, frame, map, s.params, buffers);
  }
  outcome out;
  out.holder = test::from_exec(exec, static_cast<int const*>(holder), s.holder.size());
  out.matches = test::from_exec(exec, static_cast<int const*>(work.matches), at(s.batch));
  auto const of_windows = [&](int const* data) {
    auto const all = test::from_exec(
        exec, data, at(static_cast<std::ptrdiff_t>(s.cameras) * s.batch * work.capacity));
    std::vector<int> values;
    for (int row = 0; row < s.cameras * s.batch; ++row) {
      auto const first = all.begin() + static_cast<std::ptrdiff_t>(row) * work.capacity;
      values.insert(values.end(), first, first + s.windows);
    }
    return values;
  };
  out.match = of_windows(work.match);
  out.lists = of_windows(work.list_count);
  return out;
}

template <typename Backend, bool Rounds, bool Early>
struct way_on {
  using backend = Backend;
  static constexpr bool rounds = Rounds;
  static constexpr bool early = Early;
};
struct plain_loop_on_host : way_on<test::host_backend, false, false> {};
struct plain_loop_on_host_from_early_lists : way_on<test::host_backend, false, true> {};
struct rounds_on_host : way_on<test::host_backend, true, false> {};
struct rounds_on_host_from_early_lists : way_on<test::host_backend, true, true> {};
#if defined(__CUDACC__)
struct rounds_on_device : way_on<test::cuda_backend, true, false> {};
struct rounds_on_device_from_early_lists : way_on<test::cuda_backend, true, true> {};
using ways = ::testing::Types<plain_loop_on_host, plain_loop_on_host_from_early_lists,
                              rounds_on_host, rounds_on_host_from_early_lists, rounds_on_device,
                              rounds_on_device_from_early_lists>;
#else
using ways = ::testing::Types<plain_loop_on_host, plain_loop_on_host_from_early_lists,
                              rounds_on_host, rounds_on_host_from_early_lists>;
#endif

// ---- scenes -----------------------------------------------------------------------------------

struct scene_limits {
  int batch = 6;
  int keypoints = 90;
  int windows = 140;
  int min_windows = 0;
  int width = 300, height = 220;
  float radius = 60;
};

/// A crowded scene. Descriptors come from a handful, so that distances are often equal.
scene random_scene(unsigned seed, ft::search_kind kind, int cameras, scene_limits const& limits) {
  generator g(seed);
  scene s;
  s.batch = g.from_to(1, limits.batch);
  s.cameras = cameras;
  s.step = cameras == 2 ? 2 : g.from_to(1, 2);
  s.capacity = g.from_to(1, limits.keypoints);
  s.slots = g.from_to(1, 1 + limits.windows);
  s.windows = g.from_to(std::max(1, limits.min_windows), std::max(1, limits.windows));
  s.spare = g.chance(50) ? 0 : g.below(20);
  auto const width = static_cast<float>(g.from_to(8, limits.width));
  auto const height = static_cast<float>(g.from_to(8, limits.height));
  float const min_x = g.chance(70) ? 0.0f : g.real(-30, 30);
  float const min_y = g.chance(70) ? 0.0f : g.real(-30, 30);
  s.geometry = g.chance(70) ? ft::grid_geometry::over(min_x, min_y, min_x + width, min_y + height)
                            : ft::grid_geometry::over(min_x, min_y, min_x + width, min_y + height,
                                                      g.from_to(1, 20), g.from_to(1, 20));
  s.params.kind = kind;
  if (g.chance(20)) { s.params.max_hamming = g.below(257); }
  if (g.chance(20)) { s.params.ratio = g.real(0.05f, 1.2f); }

  std::vector<ft::descriptor> looks(at(g.from_to(1, 6)));
  looks[0] = g.descriptor();
  for (std::size_t i = 1; i < looks.size(); ++i) { looks[i] = g.flipped(looks[0], g.below(160)); }
  int const flips = g.chance(40) ? 1 : g.from_to(1, 40);
  auto const look = [&] {
    return g.flipped(looks[at(g.below(static_cast<int>(looks.size())))], g.below(flips));
  };
  int const octaves = g.from_to(1, 8);
  bool const whole_pixels = g.chance(50);
  auto const place = [&](float low, float size) {
    float const v = low + g.real(-0.05f, 1.05f) * size;
    return whole_pixels ? std::floor(v) : v;
  };

  int const images = s.step * s.batch;
  for (int image = 0; image < images; ++image) {
    s.count.push_back(g.chance(5) ? 0 : g.from_to(1, s.capacity));
    for (int k = 0; k < s.capacity; ++k) {
      s.x.push_back(place(min_x, width));
      s.y.push_back(place(min_y, height));
      s.octave.push_back(g.below(octaves));
      s.orb.push_back(look());
    }
  }
  int const unobserved = g.chance(50) ? 0 : g.below(60);
  for (int i = 0; i < s.batch * s.slots; ++i) {
    s.wanted.push_back(look());
    s.observations.push_back(g.chance(unobserved) ? -g.below(2) : g.from_to(1, 9));
  }

  float const radius = g.real(1, limits.radius);
  int const absent = g.below(30);
  bool const columns = cameras == 1 && g.chance(60);
  std::ptrdiff_t const windows = static_cast<std::ptrdiff_t>(cameras) * s.batch * s.windows;
  for (std::ptrdiff_t i = 0; i < windows; ++i) {
    ft::search_window w{};
    w.x = place(min_x, width);
    w.y = place(min_y, height);
    if (g.chance(1)) { w.x = g.real(-1e7f, 1e7f); }
    w.radius = whole_pixels && g.chance(50) ? std::floor(radius) : radius * g.real(0.5f, 1.5f);
    w.right_x = w.x - g.real(0, 20);
    int const level = g.below(octaves + 1);
    int const way = g.below(5);
    w.min_level = way == 0 ? level : (way == 1 ? 0 : level - 1);
    w.max_level = way == 0 ? -1 : (way == 2 ? level + 1 : level);
    w.slot = g.chance(absent) ? -1 : g.below(s.slots);
    w.check_right = columns && g.chance(90);
    s.window.push_back(w);
  }
  for (int b = 0; b < s.batch; ++b) {
    s.window_count.push_back(g.chance(5) ? 0 : g.from_to(s.windows / 2, s.windows));
  }
  if (columns) {
    for (int i = 0; i < s.batch * s.capacity; ++i) {
      float const x = s.x[at(static_cast<std::ptrdiff_t>(i / s.capacity) * s.step * s.capacity +
                             i % s.capacity)];
      s.right_x.push_back(g.chance(30) ? -1.0f : x - g.real(0, 40));
    }
  }
  if (cameras == 2 && g.chance(85)) {
    int const paired = g.below(100);
    for (int i = 0; i < s.batch * s.numbers(); ++i) {
      int const other = i % s.numbers() < s.capacity ? s.capacity : 0;
      s.partner.push_back(g.chance(paired) ? other + g.below(s.capacity) : -1);
    }
    if (g.chance(60)) {  // as stereo matching leaves it: right entries point back
      for (int b = 0; b < s.batch; ++b) {
        int* const p = s.partner.data() + static_cast<std::ptrdiff_t>(b) * s.numbers();
        std::fill(p + s.capacity, p + s.numbers(), -1);
        for (int k = 0; k < s.capacity; ++k) {
          if (p[k] >= 0) { p[p[k]] = k; }
        }
      }
    }
  }
  int const held = g.chance(40) ? 0 : g.below(70);
  for (int i = 0; i < s.batch * s.numbers(); ++i) {
    s.holder.push_back(g.chance(held) ? g.below(s.slots) : -1);
  }
  s.params.from_empty = g.chance(30);
  return s;
}

/// Two cameras, in whose frames most keypoints are held when the search begins, mostly by observed
/// points, and have stereo partners; windows are wide, and see more keypoints than a list holds.
/// @param guests of 100 points that are looked for, so many have no observations
scene held_scene(unsigned seed, ft::search_kind kind, int guests, scene_limits const& limits) {
  scene s = random_scene(seed, kind, 2, limits);
  generator g(seed + 1000000);
  s.params.from_empty = false;
  // The first half of the map is held, the second looked for.
  int const halved = std::max(1, s.slots / 2);
  int const lapsed = g.below(40);
  for (int i = 0; i < s.batch * s.slots; ++i) {
    int const unobserved = i % s.slots < halved ? lapsed : guests;
    s.observations[at(i)] = g.chance(unobserved) ? -g.below(2) : g.from_to(1, 9);
  }
  int const held = g.from_to(60, 100);
  for (auto& h : s.holder) { h = g.chance(held) ? g.below(halved) : -1; }
  for (auto& w : s.window) {
    if (w.slot >= 0 && halved < s.slots) { w.slot = halved + g.below(s.slots - halved); }
    if (g.chance(50)) { w.min_level = 0, w.max_level = -1; }
  }
  int const paired = g.from_to(30, 100);
  s.partner.assign(at(s.batch) * at(s.numbers()), -1);
  for (int b = 0; b < s.batch; ++b) {
    int* const p = s.partner.data() + static_cast<std::ptrdiff_t>(b) * s.numbers();
    for (int k = 0; k < s.capacity; ++k) {
      int const other = s.capacity + g.below(s.capacity);
      if (!g.chance(paired) || p[other] >= 0) { continue; }
      p[k] = other;
      p[other] = k;
    }
  }
  return s;
}

/// A search from the last frame whose matches are checked for their rotation. @param guests as in
/// held_scene
scene turned_scene(unsigned seed, int cameras, int guests, scene_limits const& limits) {
  scene s = random_scene(seed, ft::search_kind::last_frame, cameras, limits);
  generator g(seed + 2000000);
  s.turned = true;
  s.params.from_empty = true;
  for (auto& o : s.observations) { o = g.chance(guests) ? -g.below(2) : g.from_to(1, 9); }
  // Most turn by about the same, some by anything; a few lie where bins begin.
  float const turn = g.real(0, 360);
  int const others = g.from_to(0, 60);
  auto const wrapped = [](float a) { return a < 0 ? a + 360 : (a >= 360 ? a - 360 : a); };
  for (int i = 0; i < s.step * s.batch * s.capacity; ++i) {
    s.angle.push_back(g.chance(others) ? g.real(0, 360) : wrapped(g.real(-20, 20)));
  }
  for (int i = 0; i < 2 * s.batch * s.windows; ++i) {
    s.last_angle.push_back(g.chance(10) ? 15.0f * static_cast<float>(g.below(24))
                                        : wrapped(turn + g.real(-20, 20)));
  }
  for (int const n : s.window_count) { s.last_left.push_back(cameras == 1 ? n : g.below(n + 1)); }
  return s;
}

/// Points that displace each other: point i wants keypoint i - 1 most and keypoint i next.
scene chain(int links, bool backwards) {
  scene s;
  s.capacity = links + 1;
  s.slots = links;
  s.windows = links;
  s.geometry = ft::grid_geometry::over(0, 0, static_cast<float>(8 * links + 16), 48);
  s.count = {links + 1};
  s.params.kind = ft::search_kind::last_frame;
  ft::descriptor const none{};
  for (int k = 0; k <= links; ++k) {
    s.x.push_back(static_cast<float>(8 * k + 4));
    s.y.push_back(20);
    s.octave.push_back(0);
    ft::descriptor d = none;
    d.words[0] = (1u << (k % 20)) - 1u;  // nearer to the zero descriptor, the smaller k % 20
    s.orb.push_back(d);
    s.holder.push_back(-1);
  }
  for (int i = 0; i < links; ++i) {
    int const k = backwards ? links - 1 - i : i;
    s.wanted.push_back(none);
    s.observations.push_back(1);
    s.window.push_back({static_cast<float>(8 * k + 8), 20, 5, 0, 0, -1, i, false});
  }
  s.window_count = {links};
  return s;
}

template <typename Way>
class greedy_assignment_test : public ::testing::Test {
protected:
  void SetUp() override {
    if (!Way::backend::available()) { GTEST_SKIP() << "no CUDA device"; }
    backend_ = std::make_unique<typename Way::backend>();
  }

  void compare(scene const& s) { compare(s, search<Way>(backend_->exec, s)); }

  void compare(scene const& s, outcome const& got) {
    outcome const want = search_in_order(s, seen_);
    for (int b = 0; b < s.batch; ++b) {
      ASSERT_EQ(got.matches[at(b)], want.matches[at(b)])
          << "number of matches of batch entry " << b;
      for (int k = 0; k < s.numbers(); ++k) {
        auto const i = at(static_cast<std::ptrdiff_t>(b) * s.numbers() + k);
        ASSERT_EQ(got.holder[i], want.holder[i])
            << "holder of keypoint " << k << " of batch entry " << b;
      }
      for (int c = 0; c < s.cameras; ++c) {
        for (int i = 0; i < s.window_count[at(b)]; ++i) {
          auto const w = at((static_cast<std::ptrdiff_t>(c) * s.batch + b) * s.windows + i);
          ASSERT_EQ(got.match[w], want.match[w])
              << "match of window " << i << ", camera " << c << ", batch entry " << b;
        }
      }
    }
  }

  void compare_many(ft::search_kind kind, int cameras, int scenes, scene_limits const& limits,
                    unsigned first_seed) {
    for (int i = 0; i < test::effort(scenes); ++i) {
      unsigned const seed = first_seed + static_cast<unsigned>(i);
      SCOPED_TRACE("seed " + std::to_string(seed));
      compare(random_scene(seed, kind, cameras, limits));
      if (this->HasFatalFailure()) { return; }
    }
  }

  /// What is left out of the lists is what is held, and is counted.
  void check_lists(scene const& s, outcome const& got) {
    using work = ft::search_workspace;
    bool const local = s.params.kind == ft::search_kind::local_map;
    auto const cells = cells_of(s);
    auto const number = [&](int c, int b, int i) {
      return at((static_cast<std::ptrdiff_t>(c) * s.batch + b) * s.windows + i);
    };
    for (int b = 0; b < s.batch; ++b) {
      for (int i = 0; i < s.window_count[at(b)]; ++i) {
        bool listed = true;
        for (int c = 0; c < s.cameras; ++c) {
          SCOPED_TRACE("window " + std::to_string(i) + ", camera " + std::to_string(c));
          ft::search_window const& w = s.window[number(c, b, i)];
          int const lists = got.lists[number(c, b, i)];
          if (!listed || w.slot < 0) {
            ASSERT_EQ(lists, 0);
            listed = listed && local;
            continue;
          }
          auto const area = keypoints_in_area(s, cells, s.image(b, c), w);
          listed = local || !area.empty();
          bool held = false;
          bool held_near = false;
          for (int const k : area) {
            if (!held_before(s, b, c * s.capacity + k)) { continue; }
            held = true;
            held_near =
                held_near ||
                bit_distance(
                    s.wanted[at(static_cast<std::ptrdiff_t>(b) * s.slots + w.slot)],
                    s.orb[at(static_cast<std::ptrdiff_t>(s.image(b, c)) * s.capacity + k)]) <=
                    s.params.max_hamming;
          }
          bool const left_out = (lists & work::left_out) != 0;
          bool const unlisted = (lists & work::unlisted) != 0;
          ASSERT_TRUE(left_out || !held_near || (Way::early && unlisted))
              << "a candidate is held, and was not left out";
          ASSERT_TRUE(held || !left_out) << "nobody holds a candidate";
          if (!left_out) { continue; }
          bool const observed =
              s.observations[at(static_cast<std::ptrdiff_t>(b) * s.slots + w.slot)] > 0;
          ASSERT_EQ((lists & work::observed) != 0, observed);
          int const count = lists & work::counted;
          ++seen_.left_out;
          seen_.left_out_of_long += static_cast<long>(unlisted);
          seen_.left_out_alone += static_cast<long>(count == 0);
          seen_.returned_alone += static_cast<long>(count == 0 && got.match[number(c, b, i)] >= 0);
          (observed ? seen_.left_out_of_observed : seen_.left_out_of_guests) += 1;
        }
      }
    }
  }

  void compare_held(scene const& s) {
    outcome const got = search<Way>(backend_->exec, s);
    compare(s, got);
    if (!this->HasFatalFailure()) { check_lists(s, got); }
  }
  void compare_held(ft::search_kind kind, int guests, int scenes, unsigned first_seed) {
    scene_limits crowd;
    crowd.batch = 3;
    crowd.keypoints = 130;
    crowd.windows = 120;
    crowd.min_windows = 30;
    crowd.width = 120;
    crowd.height = 90;
    for (int i = 0; i < test::effort(scenes); ++i) {
      unsigned const seed = first_seed + static_cast<unsigned>(i);
      SCOPED_TRACE("seed " + std::to_string(seed));
      compare_held(held_scene(seed, kind, guests, crowd));
      if (this->HasFatalFailure()) { return; }
    }
  }

  std::unique_ptr<typename Way::backend> backend_;  // made where there is a device only
  tally seen_;
};
TYPED_TEST_SUITE(greedy_assignment_test, ways);

TYPED_TEST(greedy_assignment_test, local_map_with_one_camera) {
  this->compare_many(ft::search_kind::local_map, 1, 600, {}, 10000);
  if (test::effort(100) < 100) { return; }  // too few scenes to count on
  auto const& seen = this->seen_;
  EXPECT_GT(seen.frames, 1000);
  EXPECT_GT(seen.taken, 2000);
  EXPECT_GT(seen.long_lists, 1000);
  EXPECT_GT(seen.blocked, 2000);
  EXPECT_GT(seen.retaken, 200);
  EXPECT_GT(seen.outside_column, 2000);
  EXPECT_GT(seen.equal_distances, 100);
}

TYPED_TEST(greedy_assignment_test, last_frame_with_one_camera) {
  this->compare_many(ft::search_kind::last_frame, 1, 600, {}, 20000);
  if (test::effort(100) < 100) { return; }  // too few scenes to count on
  auto const& seen = this->seen_;
  EXPECT_GT(seen.taken, 5000);
  EXPECT_GT(seen.long_lists, 1000);
  EXPECT_GT(seen.blocked, 2000);
  EXPECT_GT(seen.retaken, 200);
  EXPECT_GT(seen.equal_distances, 1000);
}

TYPED_TEST(greedy_assignment_test, local_map_with_two_cameras) {
  this->compare_many(ft::search_kind::local_map, 2, 600, {}, 30000);
  if (test::effort(100) < 100) { return; }  // too few scenes to count on
  auto const& seen = this->seen_;
  EXPECT_GT(seen.taken, 5000);
  EXPECT_GT(seen.long_lists, 1000);
  EXPECT_GT(seen.blocked, 2000);
  EXPECT_GT(seen.refused_left, 2000);
  EXPECT_GT(seen.partner_overrun, 500);
}

TYPED_TEST(greedy_assignment_test, last_frame_with_two_cameras) {
  this->compare_many(ft::search_kind::last_frame, 2, 600, {}, 40000);
  if (test::effort(100) < 100) { return; }  // too few scenes to count on
  auto const& seen = this->seen_;
  EXPECT_GT(seen.taken, 5000);
  EXPECT_GT(seen.long_lists, 1000);
  EXPECT_GT(seen.right_not_reached, 1000);
}

TYPED_TEST(greedy_assignment_test, what_is_held_is_left_out_and_returns_where_it_is_given_up) {
  this->compare_held(ft::search_kind::local_map, 30, 400, 80000);
  if (test::effort(100) < 100) { return; }  // too few scenes to count on
  auto const& seen = this->seen_;
  EXPECT_GT(seen.left_out_of_observed, 20000);
  EXPECT_GT(seen.left_out_of_guests, 8000);
  EXPECT_GT(seen.left_out_of_long, 1500);
  EXPECT_GT(seen.left_out_alone, 6000);
  EXPECT_GT(seen.returned_alone, 10);
  EXPECT_GT(seen.freed, 100);
  EXPECT_GT(seen.partner_overrun, 1000);
}

TYPED_TEST(greedy_assignment_test, what_is_held_is_not_given_up_where_all_points_are_observed) {
  this->compare_held(ft::search_kind::local_map, 0, 200, 82000);
  if (test::effort(100) < 100) { return; }  // too few scenes to count on
  auto const& seen = this->seen_;
  EXPECT_GT(seen.left_out_of_observed, 10000);
  EXPECT_EQ(seen.left_out_of_guests, 0);
  EXPECT_GT(seen.left_out_of_long, 800);
  EXPECT_GT(seen.left_out_alone, 3000);
  EXPECT_EQ(seen.freed, 0);
}

TYPED_TEST(greedy_assignment_test, what_is_held_stays_so_in_a_search_from_the_last_frame) {
  this->compare_held(ft::search_kind::last_frame, 0, 200, 84000);
  this->compare_held(ft::search_kind::last_frame, 30, 200, 86000);
  if (test::effort(100) < 100) { return; }  // too few scenes to count on
  auto const& seen = this->seen_;
  EXPECT_GT(seen.left_out_of_observed, 15000);
  EXPECT_GT(seen.left_out_of_guests, 2500);
  EXPECT_GT(seen.left_out_of_long, 1500);
  EXPECT_GT(seen.left_out_alone, 4000);
  EXPECT_EQ(seen.returned_alone, 0);
  EXPECT_EQ(seen.freed, 0);
}

TYPED_TEST(greedy_assignment_test,
           what_is_held_returns_in_frames_that_block_scratch_does_not_hold) {
  constexpr int scratch_size = ft::detail::assign_keypoints<true>::scratch_size;
  scene_limits large;
  large.batch = 1;
  large.keypoints = 4000;
  large.windows = 5000;
  large.min_windows = 4000;
  large.width = 752;
  large.height = 480;
  int beyond = 0;
  for (unsigned seed = 88001; seed < 88001 + static_cast<unsigned>(test::effort(4)); ++seed) {
    SCOPED_TRACE("seed " + std::to_string(seed));
    scene const s = held_scene(seed, ft::search_kind::local_map, 30, large);
    beyond += static_cast<int>(s.numbers() > scratch_size && s.window_count[0] > scratch_size);
    this->compare_held(s);
    if (this->HasFatalFailure()) { return; }
  }
  if (test::effort(100) < 100) { return; }  // too few scenes to count on
  EXPECT_GE(beyond, 2);
  EXPECT_GT(this->seen_.left_out_of_long, 200);
  EXPECT_GT(this->seen_.returned_alone, 5);
  EXPECT_GT(this->seen_.freed, 20);
}

TYPED_TEST(greedy_assignment_test, matches_of_rare_rotations_are_dropped) {
  scene_limits large;  // more keypoints and points than block scratch keeps
  large.batch = 1;
  large.keypoints = 4000;
  large.windows = large.min_windows = 5000;
  large.width = 752;
  large.height = 480;
  large.radius = 12;
  for (int cameras = 1; cameras <= 2; ++cameras) {
    for (int const guests : {0, 30}) {
      for (int i = 0; i < test::effort(300); ++i) {
        auto const seed = 90000u + static_cast<unsigned>(i);
        SCOPED_TRACE("seed " + std::to_string(seed) + ", cameras: " + std::to_string(cameras) +
                     ", guests: " + std::to_string(guests));
        this->compare(turned_scene(seed, cameras, guests, {}));
        if (this->HasFatalFailure()) { return; }
      }
      this->compare(turned_scene(95000, cameras, guests, large));
      if (this->HasFatalFailure()) { return; }
    }
  }
  if (test::effort(100) < 100) { return; }  // too few scenes to count on
  EXPECT_GT(this->seen_.taken, 30000);
  EXPECT_GT(this->seen_.dropped, 8000);
}

TYPED_TEST(greedy_assignment_test, one_point_or_one_keypoint) {
  scene_limits few;
  few.keypoints = 2;
  few.windows = 3;
  few.width = few.height = 40;
  for (int cameras = 1; cameras <= 2; ++cameras) {
    this->compare_many(ft::search_kind::local_map, cameras, 200, few, 50000);
    this->compare_many(ft::search_kind::last_frame, cameras, 200, few, 51000);
  }
}

TYPED_TEST(greedy_assignment_test, many_points_want_few_keypoints) {
  scene_limits crowd;
  crowd.batch = 3;
  crowd.keypoints = 12;
  crowd.windows = 1500;
  crowd.min_windows = 500;
  crowd.width = crowd.height = 30;
  for (int cameras = 1; cameras <= 2; ++cameras) {
    this->compare_many(ft::search_kind::local_map, cameras, 20, crowd, 60000);
    this->compare_many(ft::search_kind::last_frame, cameras, 20, crowd, 61000);
  }
}

TYPED_TEST(greedy_assignment_test, twenty_thousand_points) {
  scene_limits large;
  large.batch = 2;
  large.keypoints = 2000;
  large.windows = 20000;
  large.min_windows = 20000;
  large.width = 752;
  large.height = 480;
  large.radius = 12;
  this->compare_many(ft::search_kind::local_map, 1, 1, large, 70001);
  this->compare_many(ft::search_kind::last_frame, 1, 1, large, 70002);
  this->compare_many(ft::search_kind::local_map, 2, 1, large, 70003);
}

TYPED_TEST(greedy_assignment_test, chains_of_displacement) {
  for (int const links : {1, 2, 17, 100, 700}) {
    for (bool const backwards : {false, true}) {
      SCOPED_TRACE(std::to_string(links) + " links");
      this->compare(chain(links, backwards));
      if (this->HasFatalFailure()) { return; }
    }
  }
  EXPECT_GT(this->seen_.blocked, 500);
}

TYPED_TEST(greedy_assignment_test, rotations_of_more_points_than_block_scratch_keeps) {
  constexpr int scratch_size = ft::detail::assign_keypoints<true>::scratch_size;
  scene_limits large;
  large.batch = 1;
  large.keypoints = 1200;
  large.windows = large.min_windows = scratch_size + 500;
  large.width = 752;
  large.height = 480;
  large.radius = 12;
  for (int cameras = 1; cameras <= 2; ++cameras) {
    for (unsigned seed = 96000; seed < 96004; ++seed) {
      SCOPED_TRACE("seed " + std::to_string(seed) + ", cameras: " + std::to_string(cameras));
      this->compare(turned_scene(seed, cameras, 0, large));
      if (this->HasFatalFailure()) { return; }
    }
  }
}

}  // namespace greedy_assignment
