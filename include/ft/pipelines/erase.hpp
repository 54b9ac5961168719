// SPDX-License-Identifier: Apache-2.0
/// @file An odometry of any executor and rig behind the interface of any_odometry.
#pragma once

#include <cstddef>
#include <cstdint>
#include <istream>
#include <memory>
#include <ostream>
#include <string>
#include <type_traits>
#include <utility>
#include <vector>

#include "ft/any_odometry.hpp"
#include "ft/cameras/check_calibration.hpp"
#include "ft/containers/vocabulary.hpp"
#include "ft/core/config.hpp"
#include "ft/core/cuda_handles.hpp"
#include "ft/core/execution.hpp"
#include "ft/pipelines/odometry.hpp"
#include "ft/types/features.hpp"
#include "ft/types/images.hpp"
#include "ft/types/loops.hpp"
#include "ft/types/tracking.hpp"

namespace ft {
inline namespace FT_ABI {
namespace detail {

/// Where calls run: as they come.
struct calling_thread {
  calling_thread enter() const { return {}; }
};

/// The first images of a frame that a rig has, in its own form.
template <typename Rig>
void give_images(any_images const& from, Rig const&, stereo_images& to) {
  to = {from.gray[0], from.gray[1]};
}
template <typename Rig>
void give_images(any_images const& from, Rig const&, gray_view& to) {
  to = from.gray[0];
}
template <typename Rig>
void give_images(any_images const& from, Rig const&, rgbd_images& to) {
  to = {from.gray[0], from.depth};
}
template <typename Rig, int N>
void give_images(any_images const& from, Rig const& rig, rig_images<N>& to) {
  gray_view const* next = from.gray;
  for (int c = 0; c < Rig::cameras; ++c) {
    if (rig.of[c].used) { to.of[2 * c] = *next++; }
    if (!rig.of[c].single()) { to.of[2 * c + 1] = *next++; }
  }
}
template <int N>
void give_images(any_images const& from, mixed_rig<N> const& rig, mixed_images<N>& to) {
  rig_images<2 * N> gray;
  give_images(from, rig, gray);
  depth_view const* next = from.depths;
  for (int i = 0; i < 2 * N; ++i) { to.of[i] = gray.of[i]; }
  for (int c = 0; c < N; ++c) {
    if (rig.of[c].has_depth_image) { to.depth[c] = *next++; }
  }
}

/// @tparam Place has enter(), whose result lives during a call, and outlives the odometry
template <typename Exec, typename Rig, typename Place>
class erased_odometry final : public any_odometry::interface {
  using inner_type = odometry<Exec, Rig>;
  using images_type = typename inner_type::images_type;

public:
  /// @param words to be kept for the odometry
  /// @param make odometry<Exec, Rig>(Place&, vocabulary_view const&)
  template <typename Make>
  erased_odometry(Place place, vocabulary<Exec::space> words, Make const& make)
      : place_(std::move(place)),
        words_(std::move(words)),
        inner_(make(place_, words_.view())),
        images_(static_cast<std::size_t>(inner_.batch())) {}

  tracking const* track(any_images const* images, std::int64_t const* time_ns) override {
    [[maybe_unused]] auto const here = place_.enter();
    return inner_.track(given(images), time_ns);
  }
  tracking const* track_features(given_features const* features,
                                 std::int64_t const* time_ns) override {
    [[maybe_unused]] auto const here = place_.enter();
    return inner_.track(features, time_ns);
  }
  void prefetch(any_images const* images) override {
    [[maybe_unused]] auto const here = place_.enter();
    inner_.prefetch(given(images));
  }
  void forget_prefetched() override {
    [[maybe_unused]] auto const here = place_.enter();
    inner_.forget_prefetched();
  }
  tracking const* track_prefetched(std::int64_t const* time_ns) override {
    [[maybe_unused]] auto const here = place_.enter();
    return inner_.track_prefetched(time_ns);
  }
  void wait_for([[maybe_unused]] void* stream) override {
#if defined(__CUDACC__)
    if constexpr (Exec::space == memory_space::device) {
      [[maybe_unused]] auto const here = place_.enter();
      if (written_ == nullptr) { written_ = std::make_unique<event>(); }
      written_->record(static_cast<cudaStream_t>(stream));
      written_->make_wait(inner_.executor().stream);
    }
#endif
  }
  void add_imu(imu_measurement const& sample, int b) override { inner_.add_imu(sample, b); }
  void predict(rigid<double> const& T_world_camera, int b) override {
    inner_.predict(T_world_camera, b);
  }
  void reset(int b) override {
    [[maybe_unused]] auto const here = place_.enter();
    inner_.reset(b);
  }
  void set_mask(int b, int camera, gray_view mask) override {
    [[maybe_unused]] auto const here = place_.enter();
    inner_.set_mask(b, camera, mask);
  }
  tracking const& last(int b) const override { return inner_.last(b); }
  tracked_frame_view const& keypoints() const override {
    [[maybe_unused]] auto const here = place_.enter();
    return inner_.keypoints();
  }
  unsigned char const* matched() const override {
    [[maybe_unused]] auto const here = place_.enter();
    return inner_.matched();
  }
  odometry_map download_map(int b) const override {
    [[maybe_unused]] auto const here = place_.enter();
    return inner_.download_map(b);
  }
  std::vector<placed_keyframe> placed_keyframes(int b) const override {
    return inner_.placed_keyframes(b);
  }
  std::vector<closed_loop> closed_loops(int b) const override { return inner_.closed_loops(b); }
  map_snapshot snapshot_map(int b) const override {
    [[maybe_unused]] auto const here = place_.enter();
    return inner_.snapshot_map(b);
  }
  void load_map(std::istream& from, int b) override {
    [[maybe_unused]] auto const here = place_.enter();
    inner_.load_map(from, b);
  }
  std::vector<stage_time> stage_times() const override {
    [[maybe_unused]] auto const here = place_.enter();
    return inner_.stage_times();
  }
  allocated_bytes memory_bytes() const override { return inner_.memory_bytes(); }
  int batch() const override { return inner_.batch(); }
  int capacity() const override { return inner_.capacity(); }
  odometry_params const& params() const override { return inner_.params(); }
  std::vector<std::string> calibration_warnings() const override {
    std::vector<std::string> all;
    orb_params const& orb = inner_.params().orb;
    for (auto const& found : check_calibration(inner_.rig(), orb.width, orb.height)) {
      all.push_back(std::string(name_of(found.warning)) + ": " + found.text);
    }
    return all;
  }

private:
  images_type const* given(any_images const* images) {
    for (std::size_t b = 0; b < images_.size(); ++b) {
      give_images(images[b], inner_.rig(), images_[b]);
    }
    return images_.data();
  }

  Place place_;
  vocabulary<Exec::space> words_;
  inner_type inner_;
  std::vector<images_type> images_;  ///< of the frame that is given
#if defined(__CUDACC__)
  std::unique_ptr<event> written_;
#endif
};

}  // namespace detail

/// The interface of any_odometry for an odometry of your own, for camera models that
/// make_odometry() does not know:
///
///     ft::any_odometry odo = ft::erase(ft::odometry(exec, rig, params));
///
/// Calls run on the odometry's executor. On a GPU the caller makes its device current.
template <typename Exec, typename Rig>
any_odometry erase(odometry<Exec, Rig> of) {
  using erased = detail::erased_odometry<Exec, Rig, detail::calling_thread>;
  return any_odometry(std::make_unique<erased>(
      detail::calling_thread{}, vocabulary<Exec::space>(),
      [&](detail::calling_thread&, vocabulary_view const&) { return std::move(of); }));
}

}  // namespace FT_ABI
}  // namespace ft
