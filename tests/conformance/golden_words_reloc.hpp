// SPDX-License-Identifier: Apache-2.0
/// @file Compares relocalisations with golden_words, step by step.
#pragma once

#include <algorithm>
#include <cmath>
#include <cstddef>
#include <cstdint>
#include <string>
#include <vector>

#include "ft/cameras/kannala_brandt.hpp"
#include "ft/cameras/stereo_rig.hpp"
#include "ft/kernels/grid.hpp"
#include "ft/pipelines/relocalizer.hpp"
#include "tests/conformance/golden_sequence.hpp"
#include "tests/conformance/golden_words_input.hpp"
#include "tests/conformance/golden_words_searches.hpp"
#include "tests/support/memory.hpp"
#include "tests/support/npy.hpp"
#include "tests/support/word_groups.hpp"

namespace test {

/// A recorded relocalisation on an executor.
/// @tparam Rig of the frame
template <typename Exec, typename Rig>
class golden_relocalization {
  static constexpr int cameras = Rig::cameras;

public:
  golden_relocalization(Exec const& exec, std::string const& root, std::string const& folder,
                        Rig const& rig)
      : exec_(exec),
        folder_(folder),
        rig_(rig),
        said_(words_case(folder)),
        frame_(root, said_["frame"].get<std::string>()) {
    for (std::string const name : said_["candidates"]) {
      points_.emplace_back(root + "/" + name);
      keyframes_.emplace_back(root, points_.back().frame);
      first_slot_.push_back(slots_);
      slots_ += *points_.back().map.view().count;
      capacity_ = std::max(capacity_, keyframes_.back().size());
    }
    tree_ = words_tree(root, said_["vocabulary"].get<std::string>());
  }

  void run(conformance_table& table) {
    upload();
    relocalizer_ = {rig_, params(), {frame_.size(), capacity_, slots_, count() + 3}};
    std::vector<int> rows;
    for (int c = 0; c < count(); ++c) { rows.push_back(c); }
    relocalizer_.match(exec_, in_, rows);
    compare_matches(table["search_by_words"]);
    give_matches();
    auto const seed = read_npy<std::uint64_t>(folder_ + "/seed.npy");
    auto& r = table["relocalize"];
    auto const got = relocalizer_.relocalize_matched(
        exec_, in_, rows, seed(0), [&](auto step, int c, int value) {
          compare_step(table, static_cast<int>(step), c, value);
        });
    r.add(steps_ == read_npy<std::int32_t>(folder_ + "/log_cand_stage_value.npy").rows());
    auto const want = read_npy<std::int32_t>(folder_ + "/ok_winner.npy");
    r.add(static_cast<int>(got.found) == want(0));
    r.add(got.candidate == want(1));
    if (got.found) { compare_holders(r, "mp_final", got.candidate); }
  }

private:
  int count() const { return static_cast<int>(points_.size()); }
  std::size_t numbers() const { return at(cameras * frame_.size()); }
  static std::size_t at(int i) { return static_cast<std::size_t>(i); }

  /// Where a recorded keypoint is in a row of `capacity` keypoints per camera.
  static std::size_t place(words_frame const& f, int i, int capacity) {
    return at(i < f.left ? i : capacity + i - f.left);
  }
  template <typename T>
  static std::vector<T> spread(std::vector<T> const& packed, words_frame const& f, int capacity,
                               T const& rest) {
    std::vector<T> row(at(cameras * capacity), rest);
    for (int i = 0; i < f.size(); ++i) { row[place(f, i, capacity)] = packed.at(at(i)); }
    return row;
  }
  template <typename T>
  static void append(std::vector<T>& to, std::vector<T> const& row) {
    to.insert(to.end(), row.begin(), row.end());
  }

  ft::relocalization_params params() const {
    auto const bounds = read_npy<float>(frame_.set + "/bounds.npy");
    auto const scale = read_npy<float>(frame_.set + "/scale.npy");
    ft::relocalization_params p;
    p.frustum.min_x = bounds(0);
    p.frustum.max_x = bounds(1);
    p.frustum.min_y = bounds(2);
    p.frustum.max_y = bounds(3);
    p.frustum.levels = scale.rows();
    p.frustum.log_scale_factor = ft::log_rounded(scale(1));
    return p;
  }

  void upload() {
    kp_ = upload_keypoints(exec_, frame_);
    holder_ = to_exec(exec_, std::vector<int>(numbers(), -1));
    in_.frame.keypoints = kp_.view();
    in_.frame.cameras = cameras;
    in_.frame.keypoint_step = cameras;
    in_.frame.holder = holder_.data();
    std::string const right = folder_.substr(0, folder_.find("/reloc/")) + "/frames/" +
                              said_["frame"].get<std::string>() + "/uRight.npy";
    if (Rig::rectified && exists(right)) {
      right_x_ = to_exec(exec_, read_npy<float>(right).data);
      in_.frame.right_x = right_x_.data();
    }
    auto const scale = read_npy<float>(frame_.set + "/scale.npy");
    auto const sigma2 = read_npy<float>(frame_.set + "/sigma2.npy");
    for (int l = 0; l < scale.rows(); ++l) {
      in_.geometry.scale[l] = scale(l);
      in_.geometry.sigma2[l] = sigma2(l);
      in_.geometry.inv_sigma2[l] = 1.0f / sigma2(l);
    }
    grids_ = ft::feature_grid<Exec::space>(words_grid(frame_.set), frame_.size(), cameras);
    in_.frame.grids = grids_.view();
    ft::build_grid<ft::nearest_cell>(exec_, in_.frame.keypoints, 0, 1, cameras, in_.frame.grids);
    upload_points();
    upload_words();
  }

  /// The points of all candidates, one after the other, and which keypoints hold them.
  void upload_points() {
    ft::map_points<ft::memory_space::host> all(slots_);
    std::vector<int> held;
    for (int c = 0; c < count(); ++c) {
      auto const from = points_[at(c)].map.view();
      auto const to = all.view();
      for (int i = 0; i < *from.count; ++i) {
        int const slot = first_slot_[at(c)] + i;
        to.position(slot) = from.position(i);
        to.normal(slot) = from.normal(i);
        to.min_distance(slot) = from.min_distance(i);
        to.max_distance(slot) = from.max_distance(i);
        to.orb(slot) = from.orb(i);
        to.observations(slot) = from.observations(i);
      }
      std::vector<int> slots = points_[at(c)].holder;
      for (int& s : slots) { s = s < 0 ? -1 : s + first_slot_[at(c)]; }
      append(held, spread(slots, keyframes_[at(c)], capacity_, -1));
    }
    *all.view().count = slots_;
    map_ = ft::map_points<Exec::space>(slots_);
    ft::copy(exec_, map_.view(), all.view());
    exec_.wait();
    in_.map = map_.view();
    held_ = to_exec(exec_, held);
    in_.holder = held_.data();
  }

  /// Words of the frame and of the keyframes.
  void upload_words() {
    std::vector<words_groups> groups;
    std::vector<ft::descriptor> orb;
    std::vector<float> angle;
    std::vector<int> images;
    int const up = said_["up"].get<int>();
    auto const row = [&](words_frame const& f, int capacity) {
      std::vector<int> nodes;
      for (auto const& d : f.orb) { nodes.push_back(tree_.group(d, up)); }
      return words_groups(spread(nodes, f, capacity, -1), cameras * capacity);
    };
    for (auto const& k : keyframes_) {
      groups.push_back(row(k, capacity_));
      append(orb, spread(k.orb, k, capacity_, {}));
      append(angle, spread(k.angle, k, capacity_, 0.0f));
      images.push_back(k.left);
      if (cameras == 2) { images.push_back(k.size() - k.left); }
    }
    keyframe_groups_ = {exec_, groups, cameras * capacity_};
    frame_groups_ = {exec_, {row(frame_, frame_.size())}, cameras * frame_.size()};
    orb_ = to_exec(exec_, orb);
    angle_ = to_exec(exec_, angle);
    frame_orb_ = to_exec(exec_, spread(frame_.orb, frame_, frame_.size(), {}));
    frame_angle_ = to_exec(exec_, spread(frame_.angle, frame_, frame_.size(), 0.0f));
    first_right_ = to_exec(exec_, std::vector<int>{frame_.size()});
    images_ = to_exec(exec_, images);
    in_.keyframes = {keyframe_groups_.view(), orb_.data(), angle_.data(), nullptr};
    in_.words = {frame_groups_.view(), frame_orb_.data(), frame_angle_.data(),
                 cameras == 2 ? first_right_.data() : nullptr};
    auto& kp = in_.keyframe_keypoints;
    static_cast<ft::column<ft::field::angle>&>(kp).data = angle_.data();
    kp.capacity = capacity_;
    kp.batch = static_cast<int>(images.size());
    kp.count = images_.data();
  }

  std::vector<int> recorded_match(int c) const {
    auto match = read_npy<std::int32_t>(folder_ + "/match_" + std::to_string(c) + ".npy").data;
    for (int& s : match) { s = s < 0 ? -1 : s + first_slot_[at(c)]; }
    return spread(match, frame_, frame_.size(), -1);
  }
  /// Recorded is what the solver is given: all matches, but for the thin cases.
  void compare_matches(stage_result& r) {
    if (folder_.find("thin") != std::string::npos || folder_.find("sparse") != std::string::npos) {
      return;
    }
    auto const n = read_npy<std::int32_t>(folder_ + "/n_match.npy");
    auto const got = relocalizer_.matches();
    auto const match =
        from_exec(exec_, static_cast<int const*>(got.match), numbers() * at(count()));
    auto const found = from_exec(exec_, static_cast<int const*>(got.count), at(count()));
    for (int c = 0; c < count(); ++c) {
      if (n(c) == 0) {  // too few
        r.add(found[at(c)] < 15);
        continue;
      }
      auto const want = recorded_match(c);
      for (std::size_t k = 0; k < numbers(); ++k) {
        r.add(match[at(c) * numbers() + k] == want[k]);
      }
      r.add(found[at(c)] == n(c));
    }
  }
  void give_matches() {
    auto const n = read_npy<std::int32_t>(folder_ + "/n_match.npy");
    auto const to = relocalizer_.matches();
    for (int c = 0; c < count(); ++c) {
      auto const match = recorded_match(c);
      ft::copy(exec_, to.match + at(c) * numbers(), match.data(), match.size());
      exec_.wait();
    }
    ft::copy(exec_, to.count, n.data.data(), n.data.size());
    exec_.wait();
  }

  void compare_step(conformance_table& table, int step, int candidate, int value) {
    auto const log = read_npy<std::int32_t>(folder_ + "/log_cand_stage_value.npy");
    auto& r = table["relocalize"];
    int const row = steps_++;
    bool const there = row < log.rows();
    r.add(there && log(row, 0) == candidate && log(row, 1) == step && log(row, 2) == value);
    if (!there) { return; }
    if (step == 0) { return; }  // recorded is the frame's pose before
    compare_pose(table["relocalize_pose"], row);
    std::string const number = std::to_string(states_++);
    compare_holders(r, "mp_" + number, candidate);
    auto const want = read_npy<std::uint8_t>(folder_ + "/outlier_" + number + ".npy");
    auto const got = from_exec(exec_, relocalizer_.outliers(), numbers());
    for (int i = 0; i < frame_.size(); ++i) {
      r.add(got[place(frame_, i, frame_.size())] == want(i));
    }
  }
  void compare_holders(stage_result& r, std::string const& name, int candidate) {
    auto const want = read_npy<std::int32_t>(folder_ + "/" + name + ".npy");
    auto const got = from_exec(exec_, static_cast<int const*>(holder_.data()), numbers());
    for (int i = 0; i < frame_.size(); ++i) {
      int const slot = got[place(frame_, i, frame_.size())];
      r.add((slot < 0 ? -1 : slot - first_slot_[at(candidate)]) == want(i));
    }
  }
  void compare_pose(stage_result& r, int row) {
    auto const qt = read_npy<float>(folder_ + "/log_pose_qt.npy");
    ft::quaternion<double> const q{qt(row, 0), qt(row, 1), qt(row, 2), qt(row, 3)};
    auto const got = relocalizer_.frame_pose(exec_).template cast<double>();
    double worst = std::max({std::abs(got.t.x - static_cast<double>(qt(row, 4))),
                             std::abs(got.t.y - static_cast<double>(qt(row, 5))),
                             std::abs(got.t.z - static_cast<double>(qt(row, 6)))});
    for (int k = 0; k < 3; ++k) {
      ft::vec3<double> const axis{k == 0 ? 1.0 : 0.0, k == 1 ? 1.0 : 0.0, k == 2 ? 1.0 : 0.0};
      auto const apart = q * axis - got.R * axis;
      worst = std::max(worst, std::sqrt(ft::dot(apart, apart)));
    }
    r.add(worst <= 1e-4, worst);
  }

  Exec const& exec_;
  std::string folder_;
  Rig rig_;
  nlohmann::json said_;
  words_frame frame_;
  std::vector<words_keyframe> points_;
  std::vector<words_frame> keyframes_;
  std::vector<int> first_slot_;
  words_tree tree_;
  int slots_ = 0;
  int capacity_ = 1;
  int steps_ = 0;   ///< of the log
  int states_ = 0;  ///< that have points and flags recorded
  ft::relocalization_input in_;
  ft::relocalizer<Exec, Rig> relocalizer_;
  ft::keypoints<Exec::space> kp_;
  ft::feature_grid<Exec::space> grids_;
  ft::map_points<Exec::space> map_;
  uploaded_groups<Exec> keyframe_groups_, frame_groups_;
  ft::buffer<int, Exec::space> holder_, held_, first_right_, images_;
  ft::buffer<float, Exec::space> right_x_, angle_, frame_angle_;
  ft::buffer<ft::descriptor, Exec::space> orb_, frame_orb_;
};

/// The relocalisations of a folder of golden_words.
template <typename Exec>
void compare_relocalizations(Exec const& exec, std::string const& root, conformance_table& table) {
  for (auto const& at : cases_of(root, "reloc")) {
    words_frame const frame(root, words_case(at)["frame"].get<std::string>());
    auto const camera = [&](char const* name) {
      return read_npy<float>(frame.set + "/" + name + ".npy").data;
    };
    auto const a = camera("camera1");
    if (frame.cameras == 2) {
      using fisheye = ft::kannala_brandt<float>;
      auto const b = camera("camera2");
      auto const m = read_npy<float>(frame.set + "/Tlr.npy");
      ft::pose const T_lr{
          {{m(0, 0), m(0, 1), m(0, 2), m(1, 0), m(1, 1), m(1, 2), m(2, 0), m(2, 1), m(2, 2)}},
          {m(0, 3), m(1, 3), m(2, 3)}};
      ft::stereo_rig<fisheye, fisheye> const rig{
          {a[0], a[1], a[2], a[3], a[4], a[5], a[6], a[7]},
          {b[0], b[1], b[2], b[3], b[4], b[5], b[6], b[7]},
          T_lr.cast<ft::strict_float>().inverse().template cast<float>()};
      golden_relocalization<Exec, std::decay_t<decltype(rig)>>(exec, root, at, rig).run(table);
    } else {
      float const bf = read_npy<float>(frame.set + "/bf.npy")(0);
      auto const rig = ft::rectified_rig::from_bf({a[0], a[1], a[2], a[3]}, bf);
      golden_relocalization<Exec, ft::rectified_rig>(exec, root, at, rig).run(table);
    }
  }
}

}  // namespace test
