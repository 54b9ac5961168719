// SPDX-License-Identifier: Apache-2.0
/// @file The device's side of the shim on an executor: ft's stages over two frames and a map.
/// Compiled by nvcc for CUDA, by the host compiler otherwise; includes nothing of ORB-SLAM3.
#pragma once

#include <algorithm>
#include <cmath>
#include <cstddef>
#include <cstdint>
#include <cstring>
#include <memory>
#include <string>
#include <utility>
#include <vector>

#include "ft/cameras/image_domain.hpp"
#include "ft/cameras/kannala_brandt.hpp"
#include "ft/cameras/stereo_rig.hpp"
#include "ft/containers/fisheye_matches.hpp"
#include "ft/containers/frame.hpp"
#include "ft/containers/map_points.hpp"
#include "ft/containers/stereo_matches.hpp"
#include "ft/core/error.hpp"
#include "ft/core/execution.hpp"
#include "ft/core/recording.hpp"
#include "ft/kernels/grid.hpp"
#include "ft/kernels/pose_optimization.hpp"
#include "ft/kernels/search/assignment.hpp"
#include "ft/kernels/search/frustum.hpp"
#include "ft/kernels/search/last_frame.hpp"
#include "ft/kernels/search/local_map.hpp"
#include "ft/kernels/search/windows.hpp"
#include "ft/kernels/search/workspace.hpp"
#include "ft/kernels/stereo/fisheye.hpp"
#include "ft/kernels/stereo/rectified.hpp"
#include "ft/pipelines/orb_extractor.hpp"
#include "integration/orbslam3/call_clock.hpp"
#include "integration/orbslam3/device_tracker.hpp"
#include "integration/orbslam3/word_mover.hpp"

namespace ft {
namespace orbslam3 {
inline namespace FT_ABI {

using fisheye_rig = stereo_rig<kannala_brandt<float>, kannala_brandt<float>>;

inline pose to_pose(transform const& T) {
  static_assert(sizeof(pose) == sizeof(transform), "both are R by rows, then t");
  pose p;
  std::memcpy(&p, &T, sizeof p);
  return p;
}
inline transform to_transform(pose const& p) {
  transform T;
  std::memcpy(static_cast<void*>(&T), &p, sizeof T);
  return T;
}

/// The settings' cameras. A single kannala_brandt camera is a pair without baseline whose right one
/// has no keypoints. @throws bad_argument
template <typename Rig>
Rig rig_of(settings const& s) {
  float const* const l = s.left.values;
  if constexpr (Rig::rectified) {
    rectified_rig const rig{{l[0], l[1], l[2], l[3]}, s.baseline, s.bf};
    rig.camera.check();
    if (s.images == 2 || s.bf != 0) { rig.check(); }
    return rig;
  } else {
    float const* const r = s.images == 2 ? s.right.values : l;
    fisheye_rig rig{{l[0], l[1], l[2], l[3], l[4], l[5], l[6], l[7]},
                    {r[0], r[1], r[2], r[3], r[4], r[5], r[6], r[7]},
                    to_pose(s.T_rl)};
    if (s.images == 1) { rig.T_rl = {mat3<float>::identity(), {-1e-6f, 0.0f, 0.0f}}; }
    rig.check();
    require_invertible(rig.left, s.width, s.height, 0.25);
    require_invertible(rig.right, s.width, s.height, 0.25);
    return rig;
  }
}

/// Copies what was extracted into a frame.
struct store_keypoint {
  using scratch = no_scratch;

  template <typename Group>
  FT_HOST_DEVICE void operator()(Group, scratch&, int item, keypoints_view const& from,
                                 int const* mono_from, keypoints_view const& to,
                                 int* mono_to) const {
    int const image = item / from.capacity;
    int const i = item % from.capacity;
    int const count = from.count[image];
    if (i == 0) {
      to.count[image] = count;
      mono_to[image] = mono_from[image];
    }
    if (i >= count) { return; }
    int const at = image * to.capacity + i;
    get<field::x>(to, at) = get<field::x>(from, item);
    get<field::y>(to, at) = get<field::y>(from, item);
    get<field::angle>(to, at) = get<field::angle>(from, item);
    get<field::response>(to, at) = get<field::response>(from, item);
    get<field::octave>(to, at) = get<field::octave>(from, item);
    get<field::orb>(to, at) = get<field::orb>(from, item);
  }
};

/// Writes one record of a map change.
struct apply_map_change {
  using scratch = no_scratch;

  template <typename Group>
  FT_HOST_DEVICE void operator()(Group, scratch&, int item, map_change const& change,
                                 std::uint32_t const* words, map_points_view const& map) const {
    std::uint32_t const* at = words;
    if (item < change.positions) {
      at += item * map_change::position_words;
      get<field::position>(map, slot(at)) = {number(at[1]), number(at[2]), number(at[3])};
      return;
    }
    item -= change.positions;
    at += change.positions * map_change::position_words;
    if (item < change.views) {
      at += item * map_change::view_words;
      get<field::normal>(map, slot(at)) = {number(at[1]), number(at[2]), number(at[3])};
      get<field::min_distance>(map, slot(at)) = number(at[4]);
      get<field::max_distance>(map, slot(at)) = number(at[5]);
      return;
    }
    item -= change.views;
    at += change.views * map_change::view_words;
    if (item < change.descriptors) {
      at += item * map_change::descriptor_words;
      for (int w = 0; w < 8; ++w) { get<field::orb>(map, slot(at)).words[w] = at[1 + w]; }
      return;
    }
    item -= change.descriptors;
    at += change.descriptors * map_change::descriptor_words + item * map_change::observation_words;
    get<field::observations>(map, slot(at)) = static_cast<int>(at[1]);
  }

private:
  FT_HOST_DEVICE static int slot(std::uint32_t const* at) { return static_cast<int>(at[0]); }
  FT_HOST_DEVICE static float number(std::uint32_t bits) {
    float v;
    memcpy(&v, &bits, sizeof v);
    return v;
  }
};

/// A window that the host made.
struct recorded_window {
  int index;
  int camera;
  search_window window;
};

/// Puts recorded windows in their places.
struct place_recorded_window {
  using scratch = no_scratch;

  template <typename Group>
  FT_HOST_DEVICE void operator()(Group, scratch&, int item, recorded_window const* recorded,
                                 visibility const* seen, search_windows_view const& windows) const {
    recorded_window const r = recorded[item];
    bool const right_alone = r.camera == recorded_sight::not_right_alone;
    if (right_alone && seen[r.index].level >= 0) { return; }
    int const camera = right_alone ? 1 : r.camera;
    windows.windows[static_cast<std::ptrdiff_t>(camera) * windows.capacity + r.index] = r.window;
  }
};

/// A point that the left camera sees beyond the limit is searched in neither camera.
struct leave_out_far_point {
  using scratch = no_scratch;

  template <typename Group>
  FT_HOST_DEVICE void operator()(Group, scratch&, int item, visibility const* seen,
                                 float far_distance, search_windows_view const& windows) const {
    if (seen[item].level >= 0 && seen[item].distance > far_distance) {
      windows.windows[item] = search_window::none();
      windows.windows[windows.capacity + item] = search_window::none();
    }
  }
};

/// @tparam Rig rectified_rig: one pinhole camera, or a rectified pair; fisheye_rig: kannala_brandt
template <typename Exec, typename Rig>
class executor_tracker : public device_tracker {
  static constexpr memory_space space = Exec::space;
  static constexpr memory_space staging = staging_space<Exec>;
  static constexpr int no_slot_yet = -2;  ///< differs from what any caller writes
  static constexpr int searched = Rig::rectified ? 1 : 2;

public:
  /// Takes all memory, waits. @throws bad_argument naming the setting
  executor_tracker(Exec exec, settings const& s)
      : exec_(std::move(exec)), settings_(checked(s)), rig_(rig_of<Rig>(s)) {
    orb_params params;
    params.width = s.width;
    params.height = s.height;
    params.features = s.features;
    params.levels = s.levels;
    params.scale_factor = s.scale_factor;
    params.ini_threshold = s.ini_threshold;
    params.min_threshold = s.min_threshold;
    params.ties = s.std_sort_ties ? tie_rule::std_sort : tie_rule::stable;
    std::vector<stereo_overlap> overlaps;
    for (int i = 0; pair() && !Rig::rectified && i < 2; ++i) {
      overlaps.push_back({s.overlap[i][0], s.overlap[i][1]});
    }
    if (!pair() && s.bf == 0) {
      overlaps.push_back({s.monocular_overlap[0], s.monocular_overlap[1]});
    }
    extractor_ = orb_extractor<Exec>(exec_, params, s.images, overlaps);
    capacity_ = std::max(extractor_.capacity(), s.most_keypoints);
    grid_geometry rows;
    rows.cols = 1;
    rows.rows = s.height;
    stereo_.bf = s.bf;
    stereo_.max_disparity = s.baseline > 0 ? s.bf / s.baseline : 0;
    int const numbers = 2 * capacity_;
    frames_memory_ = arena<space>([&](carver& c) {
      for (device_frame& f : frames_) {
        carve(c, f.keypoints, capacity_, 2);
        carve(c, f.matches, capacity_, 1);
        carve(c, f.fisheye, capacity_, 1);
        carve(c, f.grids, grid_geometry::over(0, 0, 1, 1), capacity_, searched);
        f.mono = c.take<int>(2);
        f.holder = c.take<int>(static_cast<std::size_t>(numbers));
      }
      carve(c, right_rows_, rows, capacity_, 1);
      carve(c, observations_, numbers, 1);
      poses_ = c.take<pose>(3);
      slot_count_ = c.take<int>(1);
    });
    staging_memory_ = arena<staging>([&](carver& c) {
      for (frame_arrays& a : arrays_) { carve_arrays(c, a, capacity_); }
      images_ = c.take<std::uint8_t>(2 * image_bytes());
      staged_poses_ = c.take<pose>(3);
      staged_count_ = c.take<int>(1);
      found_ = c.take<int>(2);
    });
    std::memset(staging_memory_.data(), 0, staging_memory_.bytes());
    fill_bytes(exec_, frames_memory_.data(), 0, frames_memory_.bytes());
    exec_.wait();
    reserve_map(s.map_points);
    reserve_local(s.local_points);
    for (int b = 0; b < buffers; ++b) {
      extract_recordings_[b].record(exec_, [this, b](Exec const& e) { queue_extraction(e, b); });
    }
  }

  int capacity() const override { return capacity_; }
  int cameras() const override { return pair() ? searched : 1; }
  frame_arrays const& frame(int buffer) override { return arrays_[buffer]; }

  void extract(int buffer, grey_image const& left, grey_image const& right) override {
    stage_images(left, right);
    start();
    if (clock_.measuring()) {
      queue_extraction(exec_, buffer);
    } else {
      extract_recordings_[buffer].replay(exec_,
                                         [&](Exec const& e) { queue_extraction(e, buffer); });
    }
    clock_.mark(exec_, 3);
    wait();
    times_ = clock_.read();
    frames_[buffer].grid_made = false;
    bytes_.images += static_cast<std::size_t>(settings_.images) * image_bytes();
    ++bytes_.uploads;
    bytes_.results += extraction_bytes_;
    ++bytes_.downloads;
  }

  void build_pyramids(grey_image const& left, grey_image const& right) override {
    stage_images(left, right);
    upload_images(exec_);
    extractor_.build_pyramids(exec_);
    wait();
    bytes_.images += static_cast<std::size_t>(settings_.images) * image_bytes();
    ++bytes_.uploads;
  }

  void match_stereo(int buffer) override {
    detail::require(pair(), "stereo needs settings with two images");
    begin();
    queue_stereo(exec_, buffer);
    clock_.mark(exec_, 2);
    add_stereo_downloads(exec_, buffer);
    finish();
  }

  void download_level(int image, int level, unsigned char* to, std::size_t stride) override {
    detail::require_range("image", image, 0, settings_.images - 1);
    detail::require_range("pyramid level", level, 0, settings_.levels - 1);
    auto const from = extractor_.pyramid().level(image, level);
    copy_rows(exec_, to, stride, from.data, static_cast<std::size_t>(from.stride),
              static_cast<std::size_t>(from.width), from.height);
    wait();
    bytes_.results += static_cast<std::size_t>(from.width) * static_cast<std::size_t>(from.height);
    ++bytes_.downloads;
  }
  int level_width(int level) const override { return extractor_.geometry().width[level]; }
  int level_height(int level) const override { return extractor_.geometry().height[level]; }

  void send(int buffer, frame_part part) override {
    device_frame& f = frames_[buffer];
    frame_arrays const& a = arrays_[buffer];
    int const numbers = searched * capacity_;
    switch (part) {
      case frame_part::keypoints:
        for (int c = 0; c < 2; ++c) {
          int const at = c * capacity_;
          up_.add(exec_, array_of<field::orb>(f.keypoints) + at,
                  reinterpret_cast<descriptor const*>(a.descriptor + 8 * at), a.count[c]);
        }
        up_.add(exec_, f.mono, a.mono, 2);
        send(buffer, frame_part::octaves);
        send(buffer, frame_part::positions);
        break;
      case frame_part::octaves:
        up_.add(exec_, f.keypoints.count, a.count, 2);
        for (int c = 0; c < 2; ++c) {
          int const at = c * capacity_;
          up_.add(exec_, array_of<field::angle>(f.keypoints) + at, a.angle + at, a.count[c]);
          up_.add(exec_, array_of<field::octave>(f.keypoints) + at, a.octave + at, a.count[c]);
        }
        break;
      case frame_part::positions:
        for (int c = 0; c < 2; ++c) {
          int const at = c * capacity_;
          up_.add(exec_, array_of<field::x>(f.keypoints) + at, a.x + at, a.count[c]);
          up_.add(exec_, array_of<field::y>(f.keypoints) + at, a.y + at, a.count[c]);
        }
        f.grid_made = false;
        break;
      case frame_part::right_x:
        up_.add(exec_, array_of<field::right_x>(f.matches), a.right_x, a.count[0]);
        break;
      case frame_part::partner:
        up_.add(exec_, f.fisheye.partner, a.partner, numbers);
        break;
      case frame_part::holder:
        up_.add(exec_, f.holder, a.holder, numbers);
        break;
    }
  }

  void reserve_map(int slots) override {
    detail::require_range("map points", slots, 1, 1 << 26);
    if (slots <= map_.capacity) { return; }
    map_points_view bigger;
    arena<space> memory([&](carver& c) { carve(c, bigger, slots, 1); });
    if (map_.capacity > 0) { copy_map(bigger); }
    exec_.wait();
    map_ = bigger;
    map_memory_ = std::move(memory);
  }

  void change_map(map_change const& change, std::uint32_t const* words) override {
    std::size_t const n = change.words();
    if (n == 0) { return; }
    if (change_queued_) { wait(); }
    start();
    if (n > staged_changes_.size()) {
      staged_changes_ = buffer<std::uint32_t, staging>(n + n / 2);
      changes_ = buffer<std::uint32_t, space>(n + n / 2);
    }
    std::memcpy(staged_changes_.data(), words, n * sizeof *words);
    copy(exec_, changes_.data(), static_cast<std::uint32_t const*>(staged_changes_.data()), n);
    for_each_item<per_thread>(exec_, change.records(), apply_map_change{}, change,
                              static_cast<std::uint32_t const*>(changes_.data()), map_);
    change_queued_ = true;
    bytes_.map += n * sizeof *words;
    ++bytes_.uploads;
  }

  int* local_slots(int points) override {
    reserve_local(points);
    return staged_slots_;
  }
  recorded_sight* recorded_sights(int count) override {
    recorded_.resize(static_cast<std::size_t>(count));
    return recorded_.data();
  }

  int search_last_frame(last_frame_request const& r) override {
    device_frame& current = frames_[r.current];
    device_frame const& last = frames_[r.last];
    staged_poses_[0] = to_pose(r.T_cw);
    staged_poses_[1] = to_pose(r.T_lw);
    up_.add(exec_, poses_, staged_poses_, 2);
    begin();
    make_grid(current, r.image);
    last_search_params params;
    params.th = r.th;
    params.mono = r.mono;
    params.orientation_check = settings_.orientation_check;
    params.reference_quirks = settings_.reference_quirks;
    params.min_x = r.image.min_x;
    params.min_y = r.image.min_y;
    params.max_x = r.image.max_x;
    params.max_y = r.image.max_y;
    int const* const counts = arrays_[r.last].count;
    reserve_windows(searched * capacity_);
    use_windows(counts[0] + (searched == 2 ? counts[1] : 0));
    ft::search_last_frame(exec_, rig_, poses_, poses_ + 1, view_of(current),
                          last_frame_view{last.keypoints, 2, searched, last.holder}, map_, params,
                          extractor_.geometry(), windows_, work_);
    clock_.mark(exec_, 2);
    add_match_downloads(r.current);
    finish();
    return found_[0];
  }

  int search_local_map(local_map_request const& r) override {
    device_frame& current = frames_[r.buffer];
    staged_poses_[0] = to_pose(r.T_cw);
    *staged_count_ = r.points;
    up_.add(exec_, poses_, staged_poses_, 1);
    up_.add(exec_, slot_count_, staged_count_, 1);
    if (r.slots_changed) { up_.add(exec_, slots_, staged_slots_, r.points); }
    stage_recorded(r);
    begin();
    make_grid(current, r.image);
    reserve_windows(r.points);
    use_windows(r.points);
    queue_local_search(r, view_of(current));
    clock_.mark(exec_, 2);
    add_match_downloads(r.buffer);
    down_.add(exec_, staged_sights_, seen_, searched * windows_.capacity);
    finish();
    return found_[0];
  }
  sight const* sights() const override {
    static_assert(sizeof(sight) == sizeof(visibility), "the same fields in the same order");
    return reinterpret_cast<sight const*>(staged_sights_);
  }

  pose_result optimize_pose(int buffer, transform const& T_cw) override {
    device_frame& f = frames_[buffer];
    staged_poses_[0] = to_pose(T_cw);
    up_.add(exec_, poses_, staged_poses_, 1);
    begin();
    optimize_poses(exec_, rig_, view_of(f), map_, extractor_.geometry(), pose_params{}, poses_,
                   poses_ + 2, observations_);
    clock_.mark(exec_, 2);
    down_.add(exec_, staged_poses_ + 2, poses_ + 2, 1);
    down_.add(exec_, found_ + 1, observations_.inliers, 1);
    down_.add(exec_, arrays_[buffer].holder, f.holder, searched * capacity_);
    finish();
    return {to_transform(staged_poses_[2]), found_[1]};
  }

  traffic bytes() const override { return bytes_; }
  void reset_bytes() override { bytes_ = {}; }
  void measure(bool on) override { clock_.measure(on); }
  device_times times() const override { return times_; }

private:
  struct device_frame {
    keypoints_view keypoints;  ///< left, right
    stereo_matches_view matches;
    fisheye_matches_view fisheye;
    feature_grid_view grids;
    int* mono = nullptr;
    int* holder = nullptr;
    bounds grid_bounds{};
    bool grid_made = false;
  };

  static settings const& checked(settings const& s) {
    detail::require_range("images", s.images, 1, 2);
    detail::require_range("most_keypoints", s.most_keypoints, 0, 1 << 20);
    detail::require_range("local_points", s.local_points, 1, 1 << 24);
    detail::require(s.left.kind == s.right.kind || s.images == 1 || Rig::rectified,
                    "both cameras of a pair are of one kind");
    return s;
  }
  static void carve_arrays(carver& c, frame_arrays& a, int capacity) {
    auto const n = static_cast<std::size_t>(capacity);
    a.capacity = capacity;
    a.count = c.take<int>(2);
    a.mono = c.take<int>(2);
    a.x = c.take<float>(2 * n);
    a.y = c.take<float>(2 * n);
    a.angle = c.take<float>(2 * n);
    a.response = c.take<float>(2 * n);
    a.octave = c.take<int>(2 * n);
    a.descriptor = c.take<std::uint32_t>(16 * n);
    a.right_x = c.take<float>(n);
    a.depth = c.take<float>(n);
    a.partner = c.take<int>(2 * n);
    a.point = c.take<float>(3 * n);
    a.holder = c.take<int>(2 * n);
  }

  bool pair() const { return settings_.images == 2; }
  std::size_t image_bytes() const {
    return static_cast<std::size_t>(extractor_.geometry().stride[0]) *
           static_cast<std::size_t>(settings_.height);
  }

  // ---- images and extraction

  void stage_images(grey_image const& left, grey_image const& right) {
    for (int i = 0; i < settings_.images; ++i) {
      grey_image const& image = i == 0 ? left : right;
      detail::require(image.data != nullptr, "the image is null");
      if (image.width != settings_.width || image.height != settings_.height) {
        throw bad_argument("ft: the image is " + std::to_string(image.width) + "x" +
                           std::to_string(image.height) + ", the settings say " +
                           std::to_string(settings_.width) + "x" +
                           std::to_string(settings_.height));
      }
      detail::require(image.stride >= image.width, "the image's stride is below its width");
      auto const stride = static_cast<std::size_t>(extractor_.geometry().stride[0]);
      for (int y = 0; y < image.height; ++y) {
        std::memcpy(images_ + static_cast<std::size_t>(i) * image_bytes() +
                        static_cast<std::size_t>(y) * stride,
                    image.data + static_cast<std::ptrdiff_t>(y) * image.stride,
                    static_cast<std::size_t>(image.width));
      }
    }
  }
  /// Level 0 of all images in one copy: a row of it is an image.
  void upload_images(Exec const& exec) {
    copy_rows(exec, extractor_.pyramid().data,
              static_cast<std::size_t>(extractor_.geometry().bytes), images_, image_bytes(),
              image_bytes(), settings_.images);
  }
  void queue_extraction(Exec const& exec, int buffer) {
    device_frame& f = frames_[buffer];
    upload_images(exec);
    clock_.mark(exec, 1);
    extractor_.extract(exec);
    for_each_item<per_thread>(exec, settings_.images * extractor_.capacity(), store_keypoint{},
                              extractor_.keypoints(), extractor_.mono_count(), f.keypoints, f.mono);
    bool const stereo = pair() && settings_.stereo_with_extraction;
    if (stereo) { queue_stereo(exec, buffer); }
    clock_.mark(exec, 2);
    frame_arrays& a = arrays_[buffer];
    for (int c = 0; c < settings_.images; ++c) {
      int const at = c * capacity_;
      int const n = extractor_.capacity();
      down_.add(exec, a.x + at, array_of<field::x>(f.keypoints) + at, n);
      down_.add(exec, a.y + at, array_of<field::y>(f.keypoints) + at, n);
      down_.add(exec, a.angle + at, array_of<field::angle>(f.keypoints) + at, n);
      down_.add(exec, a.response + at, array_of<field::response>(f.keypoints) + at, n);
      down_.add(exec, a.octave + at, array_of<field::octave>(f.keypoints) + at, n);
      down_.add(exec, reinterpret_cast<descriptor*>(a.descriptor + 8 * at),
                array_of<field::orb>(f.keypoints) + at, n);
    }
    down_.add(exec, a.count, f.keypoints.count, settings_.images);
    down_.add(exec, a.mono, f.mono, settings_.images);
    if (stereo) { add_stereo_downloads(exec, buffer); }
    down_.flush(exec);
    extraction_bytes_ = down_.take_bytes();
  }
  void queue_stereo(Exec const& exec, int buffer) {
    device_frame& f = frames_[buffer];
    if constexpr (Rig::rectified) {
      match_stereo_rectified(exec, extractor_.pyramid(), f.keypoints, stereo_, f.matches,
                             right_rows_);
    } else {
      match_stereo_fisheye(exec, rig_, f.keypoints, f.mono, extractor_.geometry(),
                           fisheye_stereo_params{}, f.fisheye);
    }
  }
  void add_stereo_downloads(Exec const& exec, int buffer) {
    device_frame& f = frames_[buffer];
    frame_arrays& a = arrays_[buffer];
    if constexpr (Rig::rectified) {
      down_.add(exec, a.right_x, array_of<field::right_x>(f.matches), capacity_);
      down_.add(exec, a.depth, array_of<field::depth>(f.matches), capacity_);
    } else {
      down_.add(exec, a.partner, f.fisheye.partner, 2 * capacity_);
      down_.add(exec, a.depth, f.fisheye.depth, capacity_);
      down_.add(exec, reinterpret_cast<vec3<float>*>(a.point), f.fisheye.point, capacity_);
    }
  }

  // ---- map and local map

  void copy_map(map_points_view const& to) {
    auto const n = static_cast<std::size_t>(map_.capacity);
    auto const column = [&](auto* target, auto const* source) { copy(exec_, target, source, n); };
    column(array_of<field::position>(to), array_of<field::position>(map_));
    column(array_of<field::normal>(to), array_of<field::normal>(map_));
    column(array_of<field::min_distance>(to), array_of<field::min_distance>(map_));
    column(array_of<field::max_distance>(to), array_of<field::max_distance>(map_));
    column(array_of<field::orb>(to), array_of<field::orb>(map_));
    column(array_of<field::observations>(to), array_of<field::observations>(map_));
  }
  void reserve_local(int points) {
    if (points <= local_capacity_) { return; }
    int const n = points + points / 2;
    wait();
    auto const all = static_cast<std::size_t>(n);
    local_memory_ = arena<space>([&](carver& c) {
      slots_ = c.take<int>(all);
      seen_ = c.take<visibility>(searched * all);
      windows_recorded_ = c.take<recorded_window>(searched * all);
    });
    local_staging_ = arena<staging>([&](carver& c) {
      staged_slots_ = c.take<int>(all);
      staged_sights_ = c.take<visibility>(searched * all);
      staged_windows_ = c.take<recorded_window>(searched * all);
    });
    std::fill_n(staged_slots_, n, no_slot_yet);
    local_capacity_ = n;
    reserve_windows(n);
  }
  /// Memory of a search with up to `n` windows a camera.
  void reserve_windows(int n) {
    if (n <= work_.capacity) { return; }
    wait();
    int const room = std::max(n, searched * capacity_);
    windows_memory_ = arena<space>([&](carver& c) {
      carve(c, windows_, room, 1, searched);
      carve(c, work_, room, capacity_, 1, searched);
    });
  }
  /// The windows of the next search: launches are as large as it is.
  void use_windows(int n) { windows_.capacity = std::max(n, 1); }

  void stage_recorded(local_map_request const& r) {
    for (int i = 0; i < r.recorded; ++i) {
      recorded_sight const& s = recorded_[static_cast<std::size_t>(i)];
      visibility const v{s.seen.x,      s.seen.y,        s.seen.right_x,
                         s.seen.cosine, s.seen.distance, s.seen.level};
      search_window window = search_window::none();
      if (s.camera != recorded_sight::not_right_alone) {
        window = window_of(v, s.slot, s.camera == 0 ? r.th : 1.0f, Rig::rectified,
                           extractor_.geometry());
      }
      staged_windows_[i] = {s.index, s.camera, window};
    }
    up_.add(exec_, windows_recorded_, staged_windows_, r.recorded);
  }
  void queue_local_search(local_map_request const& r, frame_view const& frame) {
    local_search<Rig> search;
    search.rig = rig_;
    search.poses = poses_;
    search.slots = slots_;
    search.slot_count = slot_count_;
    search.frustum.min_x = r.image.min_x;
    search.frustum.min_y = r.image.min_y;
    search.frustum.max_x = r.image.max_x;
    search.frustum.max_y = r.image.max_y;
    search.frustum.log_scale_factor = log_rounded(settings_.scale_factor);
    search.frustum.levels = settings_.levels;
    search.params.th = r.th;
    search.params.far_distance = Rig::rectified ? r.far_distance : 0;
    search.seen = seen_;
    bool const by_both = !Rig::rectified && r.far_distance > 0;
    if (r.recorded == 0 && !by_both) {
      ft::search_local_map(exec_, search, frame, map_, extractor_.geometry(), search_params{},
                           windows_, work_, [](Exec const&) {});
      return;
    }
    find_visible_points(exec_, search, map_, extractor_.geometry(), windows_);
    if (by_both) {
      for_each_item<per_thread>(exec_, r.points, leave_out_far_point{},
                                static_cast<visibility const*>(seen_), r.far_distance, windows_);
    }
    for_each_item<per_thread>(exec_, r.recorded, place_recorded_window{},
                              static_cast<recorded_window const*>(windows_recorded_),
                              static_cast<visibility const*>(seen_), windows_);
    search_by_projection(exec_, frame, map_, windows_, search_params{}, work_);
  }

  // ---- calls

  frame_view view_of(device_frame const& f) const {
    frame_view v;
    v.keypoints = f.keypoints;
    v.cameras = searched;
    v.grids = f.grids;
    v.holder = f.holder;
    if constexpr (Rig::rectified) {
      v.right_x = settings_.bf != 0 ? array_of<field::right_x>(f.matches) : nullptr;
    } else {
      v.partner = f.fisheye.partner;
    }
    return v;
  }
  void make_grid(device_frame& f, bounds const& image) {
    if (f.grid_made && f.grid_bounds == image) { return; }
    f.grids.geometry = grid_geometry::over(image.min_x, image.min_y, image.max_x, image.max_y);
    build_grid<nearest_cell>(exec_, f.keypoints, 0, 1, searched, f.grids);
    f.grid_bounds = image;
    f.grid_made = true;
  }
  /// The first thing that a call queues begins its time.
  void start() {
    if (!started_) { clock_.mark(exec_, 0); }
    started_ = true;
  }
  void begin() {
    start();
    if (up_.flush(exec_) > 0) { ++bytes_.uploads; }
    bytes_.frame += up_.take_bytes();
    clock_.mark(exec_, 1);
  }
  void add_match_downloads(int buffer) {
    down_.add(exec_, found_, work_.matches, 1);
    down_.add(exec_, arrays_[buffer].holder, frames_[buffer].holder, searched * capacity_);
  }
  void finish() {
    if (down_.flush(exec_) > 0) { ++bytes_.downloads; }
    bytes_.results += down_.take_bytes();
    clock_.mark(exec_, 3);
    wait();
    times_ = clock_.read();
  }
  void wait() {
    exec_.wait();
    change_queued_ = false;
    started_ = false;
  }

  Exec exec_;
  settings settings_;
  Rig rig_;
  int capacity_ = 0;
  orb_extractor<Exec> extractor_;
  stereo_params stereo_;
  device_frame frames_[buffers];
  frame_arrays arrays_[buffers];
  feature_grid_view right_rows_;
  observations_view observations_;
  map_points_view map_;
  search_windows_view windows_;
  search_workspace work_;
  pose* poses_ = nullptr;  ///< expected, last frame's, optimised
  int* slot_count_ = nullptr;
  int* slots_ = nullptr;
  visibility* seen_ = nullptr;
  recorded_window* windows_recorded_ = nullptr;
  std::uint8_t* images_ = nullptr;
  pose* staged_poses_ = nullptr;
  int* staged_count_ = nullptr;
  int* found_ = nullptr;  ///< matches, inliers
  int* staged_slots_ = nullptr;
  visibility* staged_sights_ = nullptr;
  recorded_window* staged_windows_ = nullptr;
  std::vector<recorded_sight> recorded_;
  int local_capacity_ = 0;
  bool change_queued_ = false;
  bool started_ = false;
  std::size_t extraction_bytes_ = 0;
  arena<space> frames_memory_;
  arena<space> map_memory_;
  arena<space> local_memory_;
  arena<space> windows_memory_;
  arena<staging> staging_memory_;
  arena<staging> local_staging_;
  buffer<std::uint32_t, staging> staged_changes_;
  buffer<std::uint32_t, space> changes_;
  word_mover<Exec> up_;
  word_mover<Exec> down_;
  call_clock<Exec> clock_;
  traffic bytes_;
  device_times times_;
  recording<Exec> extract_recordings_[buffers];
};

/// The tracker of the settings' kind of cameras.
template <typename Exec>
std::unique_ptr<device_tracker> make_tracker_on(Exec const& exec, settings const& s) {
  if (s.left.kind == lens::pinhole) {
    return std::make_unique<executor_tracker<Exec, rectified_rig>>(exec, s);
  }
  return std::make_unique<executor_tracker<Exec, fisheye_rig>>(exec, s);
}

}  // namespace FT_ABI
}  // namespace orbslam3
}  // namespace ft
