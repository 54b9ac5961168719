// SPDX-License-Identifier: Apache-2.0
/// @file The extraction of a frame on an executor: uploads images, downloads keypoints and stereo.
#pragma once

#include <algorithm>
#include <cstddef>
#include <cstdint>
#include <cstring>
#include <vector>

#include "ft/core/error.hpp"
#include "ft/core/execution.hpp"
#include "ft/core/memory.hpp"
#include "ft/core/recording.hpp"
#include "ft/kernels/stereo/fisheye.hpp"
#include "ft/kernels/stereo/rectified.hpp"
#include "ft/kernels/upload.hpp"
#include "ft/pipelines/frame_tracker.hpp"
#include "ft/pipelines/orb_extractor.hpp"
#include "ft/types/poses.hpp"
#include "integration/orbslam3/device_frames.hpp"
#include "integration/orbslam3/executor_calls.hpp"
#include "integration/orbslam3/helper_threads.hpp"
#include "integration/orbslam3/rigs.hpp"

namespace ft::orbslam3 {
inline namespace FT_ABI {

/// Frames' keypoints on the device and on the host.
struct stored_keypoints {
  keypoints_view device;
  int* mono;
  frame_arrays host;
};

/// Copies extracted keypoints into a frame and to host memory.
struct store_keypoint {
  using scratch = no_scratch;

  template <typename Group>
  FT_HOST_DEVICE void operator()(Group, scratch&, int item, keypoints_view const& from,
                                 int const* mono_from, stored_keypoints const& out) const {
    keypoints_view const& to = out.device;
    frame_arrays const& host = out.host;
    int const image = item / from.capacity;
    int const i = item % from.capacity;
    int const count = from.count[image];
    if (i == 0) {
      host.count[image] = to.count[image] = count;
      host.mono[image] = out.mono[image] = mono_from[image];
    }
    if (i >= count) { return; }
    int const at = image * to.capacity + i;
    host.x[at] = to.x(at) = from.x(item);
    host.y[at] = to.y(at) = from.y(item);
    host.angle[at] = to.angle(at) = from.angle(item);
    host.response[at] = to.response(at) = from.response(item);
    host.octave[at] = to.octave(at) = from.octave(item);
    descriptor const d = from.orb(item);
    to.orb(at) = d;
    reinterpret_cast<descriptor*>(host.descriptor)[at] = d;
  }
};

/// @tparam Rig rectified_rig or fisheye_rig
template <typename Exec, typename Rig>
class device_extraction {
public:
  static constexpr memory_space space = Exec::space;
  static constexpr memory_space staging = staging_space<Exec>;
  static constexpr int buffers = device_tracker::buffers;

  /// Allocates all memory; waits. @throws bad_argument
  device_extraction(Exec const& exec, Rig const& rig, settings const& s, helper_threads& helpers)
      : settings_(s), helpers_(helpers), rig_(rig) {
    std::vector<stereo_overlap> overlaps;
    for (int i = 0; pair() && !Rig::rectified && i < 2; ++i) {
      overlaps.push_back({s.overlap[i][0], s.overlap[i][1]});
    }
    // As the original's monocular constructor says, not that of RGB-D: keypoints of these columns
    // come last, in reverse, and Frame::monoLeft counts the others.
    if (!pair() && s.bf == 0) { overlaps.push_back({0, 1000}); }
    extractor_ = orb_extractor<Exec>(exec, s, s.images, overlaps);
    stereo_.bf = s.bf;
    stereo_.max_disparity = s.bf > 0 ? s.bf / (s.bf / s.left.values[0]) : 0;  // bf / Frame::mb
    grid_geometry rows;
    rows.cols = 1;
    rows.rows = s.height;
    memory_ = arena<space>([&](carver& c) { carve(c, right_rows_, rows, capacity(), 1); });
    host_memory_ = arena<staging>([&](carver& c) {
      images_ = c.take<std::uint8_t>(2 * image_bytes());
      c.place(2, sources_, all_sources_);
    });
    std::memset(host_memory_.data(), 0, host_memory_.bytes());
    for (int i = 0; i < 2; ++i) { stage_with(i, extractor_.geometry().stride[0]); }
    fill_bytes(exec, memory_.data(), 0, memory_.bytes());
    features_there_.make();
    exec.wait();
  }

  /// Keypoints per image for which a frame has room.
  int capacity() const { return std::max(extractor_.capacity(), settings_.most_keypoints); }
  pyramid_geometry const& geometry() const { return extractor_.geometry(); }
  /// Two images, whose stereo matches extract() enqueues, too.
  bool pair() const { return settings_.images == 2; }

  /// Records the launches of extract() for each of `frames`, which must not move.
  void record(Exec const& exec, device_frames<Exec, Rig>& frames) {
    for (int b = 0; b < buffers; ++b) {
      feature_recordings_[b].record(exec, [&](Exec const& e) { queue_features(e, frames, b); });
      if (!pair()) { continue; }
      stereo_recordings_[b].record(exec, [&](Exec const& e) { queue_stereo(e, frames, b); });
    }
  }

  /// Enqueues all stages.
  void extract(Exec const& exec, device_frames<Exec, Rig>& frames, extraction_request const& r) {
    int const b = r.buffer;
    stage(0, r.left);
    if (pair()) {
      image_pyramid_view first = extractor_.pyramid();
      first.batch = 1;
      receive_images(exec, all_sources_, first);
      stage(1, r.right);
    }
    feature_recordings_[b].replay(exec, [&](Exec const& e) { queue_features(e, frames, b); });
    features_there_.set(exec);
    if (pair()) {
      stereo_recordings_[b].replay(exec, [&](Exec const& e) { queue_stereo(e, frames, b); });
    }
    frames.has_grid(b, image_bounds());
  }
  /// Waits for the keypoints of extract(); stereo matches may still be in flight.
  void wait_for_features() const { features_there_.wait(); }

private:
  /// Enqueues the stereo matching of a frame's keypoints from the pyramids, and the download of the
  /// matches.
  void queue_stereo(Exec const& exec, device_frames<Exec, Rig>& frames, int b) {
    device_frame& f = frames[b];
    frame_arrays const& a = frames.arrays(b);
    word_mover<Exec> down;
    if constexpr (Rig::rectified) {
      match_sorted_rows(exec, extractor_.pyramid(), f.keypoints, stereo_, f.matches, right_rows_);
      down.add(exec, a.right_x, array_of<field::right_x>(f.matches), capacity());
      down.add(exec, a.depth, array_of<field::depth>(f.matches), capacity());
    } else {
      match_stereo_fisheye(exec, fisheye_stereo<Rig>{rig_, extractor_.geometry(), f.mono, {}},
                           f.keypoints, f.fisheye);
      down.add(exec, a.partner, f.fisheye.partner, 2 * capacity());
      down.add(exec, a.depth, f.fisheye.depth, capacity());
      down.add(exec, a.point, f.fisheye.point, capacity());
    }
    down.flush(exec);
  }

  static constexpr int rows_at_a_time = 32;

  bounds image_bounds() const {
    return {0, 0, static_cast<float>(settings_.width), static_cast<float>(settings_.height)};
  }
  std::size_t image_bytes() const {
    return static_cast<std::size_t>(extractor_.geometry().stride[0]) *
           static_cast<std::size_t>(settings_.height);
  }

  /// Sets the stride of an image in the staging memory.
  void stage_with(int i, int stride) {
    all_sources_[i] = {images_ + static_cast<std::size_t>(i) * image_bytes(), stride};
    // The first image of a pair is transferred while the host copies the other one.
    sources_[i] = all_sources_[i];
    if (pair() && i == 0) { sources_[i].data = nullptr; }
  }
  /// Copies an image to the staging memory that the executor reads, in parts shared among the
  /// helper threads. Rows without gaps, as most images have them, are copied many at a time.
  void stage(int i, gray_view const& image) {
    detail::require(image.data != nullptr && image.width == settings_.width &&
                        image.height == settings_.height && image.stride >= image.width,
                    "the image is null, or of another size than the settings say");
    bool const packed = image.stride == image.width && image.width % 16 == 0;
    stage_with(i, packed ? image.width : extractor_.geometry().stride[0]);
    auto const stride = static_cast<std::size_t>(all_sources_[i].stride);
    std::uint8_t* const to = images_ + static_cast<std::size_t>(i) * image_bytes();
    helpers_.share(ceil_div(image.height, rows_at_a_time), [&](int part) {
      int const begin = part * rows_at_a_time;
      int const end = std::min(begin + rows_at_a_time, image.height);
      int const rows = packed ? end - begin : 1;
      for (int y = begin; y < end; y += rows) {
        std::memcpy(to + static_cast<std::size_t>(y) * stride,
                    image.data + static_cast<std::ptrdiff_t>(y) * image.stride,
                    static_cast<std::size_t>(rows) * static_cast<std::size_t>(image.width));
      }
    });
  }

  /// Copies keypoints into the frame and to the host, and builds the grid of their positions.
  void queue_features(Exec const& exec, device_frames<Exec, Rig>& frames, int b) {
    device_frame& f = frames[b];
    feature_grid_view grids = f.grids;
    grids.geometry = device_frames<Exec, Rig>::cells(image_bounds());
    extractor_.extract_from(exec, sources_, keypoint_grids<Rig::rectified>{grids, right_rows_});
    for_each_item<per_thread>(exec, settings_.images * extractor_.capacity(), store_keypoint{},
                              extractor_.keypoints(), extractor_.mono_count(),
                              stored_keypoints{f.keypoints, f.mono, frames.arrays(b)});
  }

  settings settings_;
  helper_threads& helpers_;
  Rig rig_;
  orb_extractor<Exec> extractor_;
  stereo_params stereo_;
  feature_grid_view right_rows_;
  std::uint8_t* images_ = nullptr;
  image_source* sources_ = nullptr;  ///< [2] that the recordings read
  image_source* all_sources_ = nullptr;
  arena<space> memory_;
  arena<staging> host_memory_;
  work_mark<Exec> features_there_;
  recording<Exec> feature_recordings_[buffers];
  recording<Exec> stereo_recordings_[buffers];
};

}  // namespace FT_ABI
}  // namespace ft::orbslam3
