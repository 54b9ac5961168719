// SPDX-License-Identifier: Apache-2.0
/// @file Compares the searches of words, recovery and monocular start with golden_words.
#pragma once

#include <algorithm>
#include <cmath>
#include <cstddef>
#include <cstdint>
#include <string>
#include <vector>

#include "ft/cameras/kannala_brandt.hpp"
#include "ft/cameras/pinhole.hpp"
#include "ft/containers/frame.hpp"
#include "ft/kernels/grid.hpp"
#include "ft/kernels/monocular/initial_matches.hpp"
#include "ft/kernels/search/keyframe.hpp"
#include "ft/kernels/words/search_by_words.hpp"
#include "tests/conformance/golden_sequence.hpp"
#include "tests/conformance/golden_words_input.hpp"
#include "tests/support/memory.hpp"
#include "tests/support/npy.hpp"
#include "tests/support/word_groups.hpp"

namespace test {

/// Compares `got`, which may be longer, with a recorded array.
inline void compare_recorded(stage_result& r, std::vector<int> const& got,
                             std::string const& file) {
  auto const want = read_npy<std::int32_t>(file);
  for (std::size_t i = 0; i < want.data.size(); ++i) { r.add(got.at(i) == want.data[i]); }
}

/// The keypoints of a frame and the nodes that they pass, on an executor.
template <typename Exec>
class uploaded_words {
public:
  uploaded_words(Exec const& exec, words_frame const& f, words_tree const& tree, int up)
      : groups_(exec, {words_groups(nodes_of(f, tree, up), f.size())}, f.size()),
        orb_(to_exec(exec, f.orb)),
        angle_(to_exec(exec, f.angle)),
        left_(to_exec(exec, std::vector<int>{f.left})),
        cameras_(f.cameras) {}

  ft::word_keypoints_view view() const {
    return {groups_.view(), orb_.data(), angle_.data(), cameras_ == 2 ? left_.data() : nullptr};
  }

private:
  static std::vector<int> nodes_of(words_frame const& f, words_tree const& tree, int up) {
    std::vector<int> of;
    for (auto const& d : f.orb) { of.push_back(tree.group(d, up)); }
    return of;
  }

  uploaded_groups<Exec> groups_;
  ft::buffer<ft::descriptor, Exec::space> orb_;
  ft::buffer<float, Exec::space> angle_;
  ft::buffer<int, Exec::space> left_;
  int cameras_;
};

template <typename Exec>
void compare_words_search(Exec const& exec, std::string const& root, std::string const& folder,
                          stage_result& r) {
  auto const said = words_case(folder);
  words_tree const tree(root, said["vocabulary"].get<std::string>());
  int const up = said["up"].get<int>();
  words_frame const keyframe(root, said["keyframe"].get<std::string>());
  words_frame const frame(root, said["frame"].get<std::string>());
  words_keyframe const points(root + "/" + said["kf"].get<std::string>());
  uploaded_words<Exec> const of_keyframe(exec, keyframe, tree, up);
  uploaded_words<Exec> const of_frame(exec, frame, tree, up);
  auto const holder = to_exec(exec, points.holder);
  ft::word_matches_view matches;
  ft::words_search_workspace work;
  ft::arena<Exec::space> const memory([&](ft::carver& c) {
    carve(c, matches, 1, frame.size());
    carve(c, work, 1, frame.size());
  });
  ft::words_search search;
  search.keyframes = of_keyframe.view();
  search.holder = holder.data();
  search.frames = of_frame.view();
  auto const n = read_npy<std::int32_t>(folder + "/n.npy");
  ft::words_search_params params;
  params.ratio = said["ratio"].get<float>();
  for (int k = 0; k < 2; ++k) {
    params.orientation_check = k == 0;
    ft::search_by_words(exec, search, params, matches, work);
    auto const got = from_exec(exec, static_cast<int const*>(matches.match), frame.orb.size());
    compare_recorded(r, got, folder + (k == 0 ? "/match.npy" : "/match_noori.npy"));
    r.add(from_exec(exec, static_cast<int const*>(matches.count), 1)[0] == n(k));
  }
}

inline ft::grid_geometry words_grid(std::string const& set) {
  auto const b = read_npy<float>(set + "/bounds.npy");
  return ft::grid_geometry::over(b(0), b(2), b(1), b(3));
}

template <typename Exec>
void compare_initial_search(Exec const& exec, std::string const& root, std::string const& folder,
                            stage_result& r) {
  auto const said = words_case(folder);
  words_frame const first(root, said["frame1"].get<std::string>());
  words_frame const second(root, said["frame2"].get<std::string>());
  auto const kp1 = upload_keypoints(exec, first);
  auto const kp2 = upload_keypoints(exec, second);
  ft::frame_pair_view frames{kp1.view(), kp2.view(), {}};
  ft::initial_matches_view out;
  ft::initial_match_workspace work;
  ft::arena<Exec::space> const memory([&](ft::carver& c) {
    carve(c, frames.grids, words_grid(second.set), kp2.capacity(), 1);
    carve(c, out, kp1.capacity(), 1);
    carve(c, work, kp1.capacity(), kp2.capacity(), 1);
  });
  ft::build_grid<ft::nearest_cell>(exec, frames.second, 0, 1, 1, frames.grids);
  ft::initial_match_params params;
  params.window_radius = said["window"].get<float>();
  params.ratio = said["ratio"].get<float>();
  auto const previous = read_npy<float>(folder + "/prev_in.npy");
  auto const n = read_npy<std::int32_t>(folder + "/n.npy");
  for (int k = 1; k >= 0; --k) {
    ft::copy(exec, &out.previous[0].x, previous.data.data(), previous.data.size());
    exec.wait();
    params.orientation_check = k == 0;
    ft::search_initial_matches(exec, frames, params, out, work);
    auto const got =
        from_exec(exec, static_cast<int const*>(out.match), static_cast<std::size_t>(first.size()));
    compare_recorded(r, got, folder + (k == 0 ? "/match.npy" : "/match_noori.npy"));
    r.add(from_exec(exec, static_cast<int const*>(out.count), 1)[0] == n(k));
  }
  auto const want = read_npy<float>(folder + "/prev_out.npy");
  auto const got = from_exec(exec, static_cast<ft::vec2<float> const*>(out.previous),
                             static_cast<std::size_t>(first.size()));
  for (int i = 0; i < first.size(); ++i) {
    auto const& p = got[static_cast<std::size_t>(i)];
    r.add(p.x == want(i, 0) && p.y == want(i, 1));
  }
}

/// A recorded search for the points of a keyframe.
/// @tparam Cameras of the frame
template <int Cameras, typename Exec, typename Camera>
void compare_keyframe_search(Exec const& exec, std::string const& root, std::string const& folder,
                             Camera const& camera, stage_result& r) {
  auto const said = words_case(folder);
  words_frame const from(root, said["keyframe"].get<std::string>());
  words_frame const to(root, said["frame"].get<std::string>());
  words_keyframe const points(root + "/" + said["kf"].get<std::string>());
  auto const kp = upload_keypoints(exec, to);
  auto const keyframe_kp = upload_keypoints(exec, from);
  ft::map_points<Exec::space> map(points.map.capacity());
  ft::copy(exec, map.view(), points.map.view());
  // Recorded arrays have the right keypoints after the left ones; a frame leaves room between them.
  auto const spread = [](std::vector<int> const& packed, words_frame const& f) {
    std::vector<int> v(static_cast<std::size_t>(Cameras * f.size()), -1);
    for (int i = 0; i < f.size(); ++i) {
      int const number = i < f.left ? i : f.size() + i - f.left;
      v[static_cast<std::size_t>(number)] = packed.at(static_cast<std::size_t>(i));
    }
    return v;
  };
  auto const read = [&](char const* name) {
    return read_npy<std::int32_t>(folder + "/" + name + ".npy").data;
  };
  std::vector<int> seen(static_cast<std::size_t>(map.capacity()), 0);
  for (int const slot : read("found")) { seen.at(static_cast<std::size_t>(slot)) = 7; }
  auto const d_seen = to_exec(exec, seen);
  auto const number = to_exec(exec, std::vector<int>{7});
  auto const pose = to_exec(exec, std::vector<ft::pose>{words_pose(folder)});
  auto const held = to_exec(exec, spread(points.holder, from));
  auto const holder = to_exec(exec, spread(read("cur_mp_before"), to));
  auto const bounds = read_npy<float>(to.set + "/bounds.npy");
  auto const scale = read_npy<float>(to.set + "/scale.npy");
  ft::frame_view frame;
  frame.keypoints = kp.view();
  frame.cameras = frame.keypoint_step = Cameras;
  frame.holder = holder.data();
  ft::search_buffers buffers;
  ft::arena<Exec::space> const memory([&](ft::carver& c) {
    int const most = Cameras * from.size();
    carve(c, frame.grids, words_grid(to.set), kp.capacity(), Cameras);
    carve(c, buffers.windows, most, 1, Cameras);
    carve(c, buffers.work, most, kp.capacity(), 1, Cameras);
  });
  ft::build_grid<ft::nearest_cell>(exec, frame.keypoints, 0, 1, Cameras, frame.grids);
  ft::keyframe_search<Camera, Cameras> search;
  search.camera = camera;
  search.T_cw = pose.data();
  search.keyframe = {keyframe_kp.view(), Cameras, Cameras, held.data()};
  search.found = {number.data(), d_seen.data()};
  search.frustum.min_x = bounds(0);
  search.frustum.max_x = bounds(1);
  search.frustum.min_y = bounds(2);
  search.frustum.max_y = bounds(3);
  search.frustum.levels = scale.rows();
  search.frustum.log_scale_factor = ft::log_rounded(scale(1));
  for (int l = 0; l < scale.rows(); ++l) { search.geometry.scale[l] = scale(l); }
  search.params.window_radius = said["th"].get<float>();
  search.params.max_hamming = said["dmax"].get<int>();
  search.params.orientation_check = said["check"].get<bool>();
  ft::search_keyframe(exec, search, frame, map.view(), buffers);
  auto const got = from_exec(exec, static_cast<int const*>(holder.data()), holder.size());
  auto const want = spread(read("cur_mp_after"), to);
  for (int i = 0; i < to.size(); ++i) {
    auto const at = static_cast<std::size_t>(i < to.left ? i : to.size() + i - to.left);
    r.add(got[at] == want[at]);
  }
  r.add(from_exec(exec, static_cast<int const*>(buffers.work.matches), 1)[0] == read("n")[0]);
}

/// The searches of a folder of golden_words.
template <typename Exec>
void compare_words_searches(Exec const& exec, std::string const& root, conformance_table& table) {
  for (auto const& at : cases_of(root, "bow_search")) {
    compare_words_search(exec, root, at, table["search_by_words"]);
  }
  for (auto const& at : cases_of(root, "init")) {
    compare_initial_search(exec, root, at, table["search_initial_matches"]);
  }
  for (auto const& at : cases_of(root, "reloc_proj")) {
    words_frame const frame(root, words_case(at)["frame"].get<std::string>());
    auto const c = read_npy<float>(frame.set + "/camera1.npy");
    auto& r = table["search_keyframe"];
    if (frame.cameras == 2) {
      compare_keyframe_search<2>(
          exec, root, at, ft::kannala_brandt<float>{c(0), c(1), c(2), c(3), c(4), c(5), c(6), c(7)},
          r);
    } else {
      compare_keyframe_search<1>(exec, root, at, ft::pinhole<float>{c(0), c(1), c(2), c(3)}, r);
    }
  }
}

}  // namespace test
