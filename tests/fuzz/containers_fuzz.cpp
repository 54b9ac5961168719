// SPDX-License-Identifier: Apache-2.0
// Shapes of containers, pieces of an arena, grids of any positions and searches in any windows,
// beside plain loops.
#include <cmath>
#include <cstring>
#include <limits>
#include <utility>
#include <vector>

#include "ft/containers/frame.hpp"
#include "ft/containers/map_points.hpp"
#include "ft/containers/soa.hpp"
#include "ft/kernels/grid.hpp"
#include "ft/kernels/search/assignment.hpp"
#include "ft/kernels/search/workspace.hpp"
#include "tests/fuzz/input.hpp"

namespace {

constexpr auto host = ft::memory_space::host;

ft::host_exec const& exec() {
  static ft::host_exec const one(1);
  return one;
}

/// Sizes as they multiply: an overflow is refused, and never a smaller piece handed out.
void carve_anything(fuzz::input& in) {
  ft::carver c;
  for (int i = in.within(0, 8); i > 0; --i) {
    auto const count = in.bits<std::size_t>() >> in.within(0, 63);
    std::size_t const before = c.used();
    bool const fits = fuzz::accepted<ft::bad_argument>([&] { c.take<ft::descriptor>(count); });
    using wide = unsigned __int128;
    wide const start = (static_cast<wide>(before) + 255) / 256 * 256;
    wide const end = start + static_cast<wide>(count) * sizeof(ft::descriptor);
    fuzz::require(fits == (end <= std::numeric_limits<std::size_t>::max()),
                  "a piece is refused where its end has no address, and only there");
    fuzz::require(c.used() == (fits ? static_cast<std::size_t>(end) : before),
                  "a carver counts what it handed out");
  }
  ft::keypoints_view view;
  int const capacity = in.bits<int>();
  int const batch = in.bits<int>();
  ft::carver measure;
  if (capacity > 0 && batch > 0 &&
      fuzz::accepted<ft::bad_argument>([&] { carve(measure, view, capacity, batch); })) {
    fuzz::require(measure.used() / sizeof(ft::descriptor) >=
                      static_cast<std::size_t>(capacity) * static_cast<std::size_t>(batch),
                  "a container's memory holds its elements");
  }
}

/// Fills, copies, slices and moves.
void use_containers(fuzz::input& in) {
  int const capacity = in.within(-1, 40);
  int const batch = in.within(-1, 5);
  bool const made = fuzz::accepted<ft::bad_argument>([&] {
    ft::keypoints<host> a(capacity, batch);
    ft::keypoints<host> b(in.flag() ? capacity : capacity + 1, batch);
    for (int e = 0; e < batch; ++e) {
      auto const slice = a.view().slice(e);
      *slice.count = in.within(0, capacity);
      for (int i = 0; i < capacity; ++i) {
        slice.x(i) = static_cast<float>(e * capacity + i);
        slice.y(i) = 0;
        slice.angle(i) = 0;
        slice.response(i) = 0;
        slice.octave(i) = i;
        slice.orb(i) = in.bits<ft::descriptor>();
      }
    }
    bool const copied = fuzz::accepted<ft::bad_argument>([&] { copy(exec(), b.view(), a.view()); });
    fuzz::require(copied == (a.capacity() == b.capacity()), "a copy is between equal shapes");
    ft::keypoints<host> const moved = std::move(a);
    fuzz::require(
        a.capacity() == 0 && a.view().count == nullptr,  // NOLINT(bugprone-use-after-move)
        "a container that was moved from is empty");
    auto const& all = copied ? b.view() : moved.view();
    for (int i = 0; i < capacity * batch; ++i) {
      fuzz::require(all.x(i) == static_cast<float>(i) && all.octave(i) == i % capacity,
                    "a copy and a move keep every element");
    }
  });
  fuzz::require(made == (capacity >= 1 && batch >= 1), "a shape without elements is refused");
}

struct field_of_keypoints {
  ft::keypoints<host> points;
  ft::feature_grid<host> grid;
  ft::grid_geometry geometry;
};

field_of_keypoints any_keypoints(fuzz::input& in, int capacity) {
  field_of_keypoints f{ft::keypoints<host>(capacity, 2),
                       {},
                       ft::grid_geometry::over(0, 0, 160, 120, in.within(1, 70), in.within(1, 60))};
  f.grid = ft::feature_grid<host>(f.geometry, capacity);
  auto const kp = f.points.view();
  for (int e = 0; e < 2; ++e) {
    kp.count[e] = in.flag() ? capacity : in.within(0, capacity);
    for (int i = e * capacity; i < (e + 1) * capacity; ++i) {
      kp.x(i) = in.number(-5, 165);
      kp.y(i) = in.number(-5, 125);
      kp.angle(i) = in.number(0, 360);
      kp.response(i) = 1;
      kp.octave(i) = in.within(0, 7);
      ft::descriptor d{};
      d.words[in.within(0, 7)] = in.bits<std::uint32_t>();
      kp.orb(i) = d;
    }
  }
  ft::build_grid<ft::nearest_cell>(exec(), kp, 0, 2, 1, f.grid.view());
  return f;
}

void check_grid(field_of_keypoints const& f) {
  auto const kp = f.points.view();
  auto const grid = f.grid.view();
  int next = 0;
  for (int cell = 0; cell < f.geometry.cells(); ++cell) {
    fuzz::require(grid.start[cell] == next, "cells follow each other");
    int last = -1;
    for (; next < grid.start[cell + 1]; ++next) {
      int const k = grid.indices[next];
      fuzz::require(k > last && k < *kp.count, "a cell's keypoints ascend");
      int const of = ft::nearest_cell::of(f.geometry, kp.x(k), kp.y(k));
      fuzz::require(of == cell, "a keypoint is in its own cell");
      last = k;
    }
  }
  int inside = 0;
  for (int i = 0; i < *kp.count; ++i) {
    inside += static_cast<int>(ft::nearest_cell::of(f.geometry, kp.x(i), kp.y(i)) >= 0);
  }
  fuzz::require(next == inside, "every keypoint inside is in one cell");
}

ft::search_window any_window(fuzz::input& in, int slots) {
  ft::search_window w = ft::search_window::none();
  w.x = in.number(-20, 180);
  w.y = in.number(-20, 140);
  w.radius = in.number(0, 60);
  w.right_x = in.number(-5, 160);
  w.min_level = in.within(-1, 8);
  w.max_level = in.within(-1, 8);
  w.slot = in.within(-1, slots - 1);
  w.check_right = in.flag();
  return w;
}

/// Whatever the windows: a keypoint is given to a point whose window it lies in.
void search(fuzz::input& in, field_of_keypoints const& f) {
  constexpr int slots = 24;
  int const windows = in.within(1, 40);
  int const capacity = f.points.capacity();
  ft::map_points<host> map(slots);
  for (int i = 0; i < slots; ++i) {
    map.view().observations(i) = in.within(0, 2);
    ft::descriptor d{};
    d.words[in.within(0, 7)] = in.bits<std::uint32_t>();
    map.view().orb(i) = d;
  }
  ft::search_windows_view in_windows;
  ft::search_workspace work;
  ft::frame_view frame;
  std::vector<float> right_x(static_cast<std::size_t>(capacity));
  for (float& v : right_x) { v = in.number(-1, 160); }
  ft::arena<host> const memory([&](ft::carver& c) {
    carve(c, in_windows, windows, 1, 1);
    carve(c, work, windows, capacity, 1, 1);
    frame.holder = c.take<int>(static_cast<std::size_t>(capacity));
  });
  frame.keypoints = f.points.view();
  frame.grids = f.grid.view();
  frame.right_x = right_x.data();
  *in_windows.count = in.flag() ? windows : in.within(0, windows);
  for (int i = 0; i < windows; ++i) { in_windows.at(0, 0, i) = any_window(in, slots); }
  for (int k = 0; k < capacity; ++k) { frame.holder[k] = -1; }
  ft::search_params params;
  params.kind = in.flag() ? ft::search_kind::last_frame : ft::search_kind::local_map;
  params.max_hamming = in.within(0, 256);
  params.ratio = in.number(0, 1);
  ft::search_by_projection(exec(), frame, map.view(), params, {in_windows, work});
  int held = 0;
  auto const kp = frame.keypoints;
  for (int k = 0; k < capacity; ++k) {
    int const slot = frame.holder[k];
    fuzz::require(slot >= -1 && slot < slots, "holders are map slots");
    if (slot < 0) { continue; }
    ++held;
    bool found = false;
    for (int i = 0; i < *in_windows.count; ++i) {
      auto const& w = in_windows.at(0, 0, i);
      found = found || (w.slot == slot && ft::inside(w, kp, k));
    }
    fuzz::require(found && k < *kp.count, "a keypoint is given to a point that looked there");
    fuzz::require(ft::hamming(kp.orb(k), map.view().orb(slot)) <= params.max_hamming,
                  "descriptors that differ too much are not matched");
  }
  fuzz::require(held <= *work.matches, "every keypoint that was given a point is counted");
}

}  // namespace

extern "C" int LLVMFuzzerTestOneInput(std::uint8_t const* data, std::size_t size) {
  fuzz::input in(data, size);
  switch (in.within(0, 2)) {
    case 0:
      carve_anything(in);
      break;
    case 1:
      use_containers(in);
      break;
    default: {
      auto const f = any_keypoints(in, in.within(1, 60));
      check_grid(f);
      search(in, f);
    }
  }
  return 0;
}
