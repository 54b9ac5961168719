// SPDX-License-Identifier: Apache-2.0
/// @file Differences between CPU and GPU, and a log of them by frame and stage.
#pragma once

#include <algorithm>
#include <array>
#include <cmath>
#include <cstddef>
#include <functional>
#include <optional>
#include <ostream>
#include <utility>
#include <vector>

#include "integration/orbslam3/options.hpp"

namespace ft::orbslam3 {

/// One value that differs, a number of keypoints at other places of the same set, or a map point
/// that changed without a hook.
struct difference {
  stage where;
  unsigned long frame;  ///< Frame::mnId
  char const* what;     ///< such as "map point", "octave"
  long index;           ///< of the keypoint, or of the point in the local map; -1 = of the frame
  double cpu;           ///< map points by mnId, -1 = none
  double gpu;
  bool number = false;  ///< only `gpu` is set, to a number
  bool stale = false;   ///< the device has an old `what` of map point `index`: a hook is missing
};

inline std::ostream& operator<<(std::ostream& out, difference const& d) {
  out << "frame " << d.frame << ", " << name_of(d.where) << ": " << d.what;
  if (d.number) { return out << ": " << d.gpu; }
  if (d.stale) { return out << " of map point " << d.index << " changed without a hook"; }
  if (d.index >= 0) { out << " " << d.index; }
  return out << ": CPU " << d.cpu << ", GPU " << d.gpu;
}

/// Differences that are accepted, because the two round differently.
struct tolerances {
  double pixels = 4e-3;  ///< of projections and right columns
  double depth = 1e-3;   ///< metres, and relative to a depth
  double cosine = 1e-5;  ///< of viewing angles
  double pose = 1e-4;    ///< of each entry
  // Of poses with an IMU. Numbers of a frame may also differ by two roundings of a float.
  double turn = 2e-6;         ///< of each entry of a rotation
  double position = 2e-6;     ///< metres
  double velocity = 1e-5;     ///< m/s
  double gyro_bias = 1e-8;    ///< rad/s
  double accel_bias = 3e-6;   ///< m/s^2
  double information = 2e-6;  ///< of the square root of both diagonal entries' product
};

/// What a call has left, as numbers that are compared one by one.
class readings {
public:
  struct entry {
    char const* what;
    long index;
    double value;
    double allowed;
  };

  template <typename T>
  void add(char const* what, long index, T value, double allowed = 0) {
    all_.push_back({what, index, static_cast<double>(value), allowed});
  }
  /// @param roundings allowed besides, relative to the value
  void add(char const* what, vec3<float> const& v, double allowed, double roundings = 0) {
    float const values[] = {v.x, v.y, v.z};
    add(what, values, values + 3, allowed, roundings);
  }
  void add(char const* what, mat3<float> const& m, double allowed, double roundings = 0) {
    add(what, m.m, m.m + 9, allowed, roundings);
  }
  /// Also their number. @param relative allowed besides, of a value
  template <typename T>
  void add(char const* what, std::vector<T> const& values, double allowed = 0,
           double relative = 0) {
    add(what, -1, values.size());
    add(what, values.begin(), values.end(), allowed, relative);
  }
  std::vector<entry> const& all() const { return all_; }

private:
  template <typename At>
  void add(char const* what, At from, At to, double allowed, double relative) {
    for (long i = 0; from != to; ++from, ++i) {
      add(what, i, *from, allowed + relative * std::abs(static_cast<double>(*from)));
    }
  }
  std::vector<entry> all_;
};

/// Counts and prints differences. For one thread.
class difference_log {
public:
  using report = std::function<void(difference const&)>;

  /// @param to called with every difference; may be empty
  explicit difference_log(report to) : report_(std::move(to)) {}

  long differences() const { return differences_; }
  /// Prints a line for each later frame, with the first difference of each stage.
  void print_frames(std::ostream& out) { lines_ = &out; }

  /// A call of stage `s` in frame `id` begins.
  void begin(unsigned long id, stage s) {
    if (!in_frame_ || id != frame_) {
      end_frame();
      in_frame_ = true;
      frame_ = id;
      ++frames_;
      before_frame_ = differences_;
    }
    stage_ = s;
    ++tallies_[static_cast<std::size_t>(s)].calls;
    before_call_ = differences_;
  }
  /// Makes a call: `trial` runs the CPU, the accelerator, and the CPU again, and compares. Mapping
  /// may change the map in between more than once. So what differs counts only if it does in two
  /// trials in which both of the CPU's answers are the same; other calls are counted apart.
  template <typename Trial>
  void make(Trial const& trial) {
    tally& t = tallies_[static_cast<std::size_t>(stage_)];
    found_.emplace();
    int quiet = 0;
    for (int k = 0; k < most_trials && quiet < 2; ++k) {
      found_->clear();
      moved_ = false;
      trial();
      if (found_->empty()) { break; }
      quiet += static_cast<int>(!moved_);
    }
    std::vector<difference> const found = std::move(*found_);
    found_.reset();
    if (quiet >= 2) {
      for (difference const& d : found) { add(d); }
    } else if (quiet == 1 || !found.empty()) {
      ++t.unconfirmed;
    }
  }
  /// The accelerator has refused this call, which is the CPU's then.
  void add_refusal() { ++tallies_[static_cast<std::size_t>(stage_)].refused; }
  /// Adds a value that is farther from both of the CPU's than allowed; two NaNs are equal.
  template <typename A, typename B>
  void compare(char const* what, long index, A cpu, A cpu_again, B gpu, double allowed = 0) {
    auto const a = static_cast<double>(cpu);
    auto const again = static_cast<double>(cpu_again);
    auto const b = static_cast<double>(gpu);
    moved_ = moved_ || !near(a, again, 0);
    if (near(a, b, allowed) || near(again, b, allowed)) { return; }
    add({stage_, frame_, what, index, a, b});
  }
  /// The same for a stage that does not read the map and that the CPU runs once.
  template <typename A, typename B>
  void compare(char const* what, long index, A cpu, B gpu) {
    compare(what, index, cpu, cpu, gpu);
  }
  /// The same for what all of these have; they are written in the same order.
  void compare(readings const& cpu, readings const& cpu_again, readings const& gpu) {
    auto again = cpu_again.all().begin();
    auto other = gpu.all().begin();
    auto const find = [](auto const& in, auto& from, readings::entry const& e) {
      auto const found = std::find_if(from, in.end(), [&](readings::entry const& x) {
        return x.what == e.what && x.index == e.index;
      });
      if (found == in.end()) { return false; }
      from = found;
      return true;
    };
    for (readings::entry const& e : cpu.all()) {
      if (!find(gpu.all(), other, e)) { continue; }
      bool const twice = find(cpu_again.all(), again, e);
      compare(e.what, e.index, e.value, twice ? again->value : e.value, other->value, e.allowed);
    }
  }
  void compare(readings const& cpu, readings const& gpu) { compare(cpu, cpu, gpu); }
  /// Adds a field of a map point that changed without a hook.
  void add_stale(char const* what, long point) {
    add({stage_, frame_, what, point, 0, 0, false, true});
  }
  /// Adds a number instead of a pair of values, such as the number of keypoints in another order.
  void add_number(char const* what, long number) {
    add({stage_, frame_, what, -1, 0, static_cast<double>(number), true});
  }
  /// Adds a call that was made elsewhere, with what differed, after begin() of this frame's call.
  void add_call(stage s, std::vector<difference> const& found) {
    stage const here = std::exchange(stage_, s);
    before_call_ = differences_;
    ++tallies_[static_cast<std::size_t>(s)].calls;
    for (difference const& d : found) { add(d); }
    stage_ = here;
    before_call_ = differences_;
  }

  /// Ends the last frame's line and prints the number of frames and calls, and of those with
  /// differences.
  void summary(std::ostream& out) {
    end_frame();
    out << "verify: " << frames_ << " frames, " << frames_that_differ_ << " with differences\n";
    for (int i = 0; i < stage_count; ++i) {
      tally const& t = tallies_[static_cast<std::size_t>(i)];
      if (t.calls == 0) { continue; }
      out << "verify: " << name_of(static_cast<stage>(i)) << ": " << t.calls << " calls, "
          << t.calls_that_differ << " with differences, " << t.differences << " in all";
      if (t.refused > 0) { out << ", " << t.refused << " refused"; }
      if (t.unconfirmed > 0) { out << ", " << t.unconfirmed << " unconfirmed"; }
      out << "\n";
    }
  }

private:
  struct tally {
    long calls = 0;
    long calls_that_differ = 0;
    long differences = 0;
    long refused = 0;
    long unconfirmed = 0;
  };
  static constexpr int most_trials = 10;

  void end_frame() {
    if (!in_frame_) { return; }
    in_frame_ = false;
    long const n = differences_ - before_frame_;
    frames_that_differ_ += static_cast<long>(n > 0);
    if (lines_ == nullptr) { return; }
    *lines_ << "verify: frame " << frame_ << ": " << n << " differences";
    for (difference const& d : first_) { *lines_ << "; " << d; }
    *lines_ << "\n";
    first_.clear();
  }
  void add(difference const& d) {
    if (found_) { return found_->push_back(d); }
    tally& t = tallies_[static_cast<std::size_t>(stage_)];
    if (differences_ == before_call_) {
      ++t.calls_that_differ;
      if (lines_ != nullptr) { first_.push_back(d); }
    }
    ++t.differences;
    ++differences_;
    if (report_) { report_(d); }
  }
  static bool near(double a, double b, double allowed) {
    return std::abs(a - b) <= allowed || (std::isnan(a) && std::isnan(b));
  }

  report report_;
  std::ostream* lines_ = nullptr;
  std::array<tally, stage_count> tallies_{};
  std::vector<difference> first_;                 ///< of this frame's calls
  std::optional<std::vector<difference>> found_;  ///< in a trial
  bool moved_ = false;                            ///< in a trial: the CPU's answers differ
  stage stage_ = stage::extract;
  unsigned long frame_ = 0;
  bool in_frame_ = false;
  long frames_ = 0;
  long frames_that_differ_ = 0;
  long differences_ = 0;
  long before_frame_ = 0;
  long before_call_ = 0;
};

}  // namespace ft::orbslam3
