// SPDX-License-Identifier: Apache-2.0
/// @file The functions that ORB-SLAM3's files call. Each stage runs on the accelerator, in
/// ORB-SLAM3's own code, or in both to compare them.
#pragma once

#include <atomic>
#include <exception>
#include <iostream>
#include <memory>
#include <ostream>
#include <set>
#include <string>
#include <thread>
#include <type_traits>
#include <utility>
#include <vector>

#include "integration/orbslam3/accelerator.hpp"
#include "integration/orbslam3/change_queue.hpp"
#include "integration/orbslam3/options.hpp"
#include "integration/orbslam3/settings_of.hpp"
#include "integration/orbslam3/verify.hpp"

namespace ft::orbslam3 {

template <typename Types>
class front_end;

namespace front_end_detail {

template <typename Cpu, typename Image>
void extract(Cpu const& cpu, Image const& image) {
  cpu(0, image);
}
/// Of a pair, by two threads as the original does.
template <typename Cpu, typename Image>
void extract(Cpu const& cpu, Image const& left, Image const& right) {
  std::thread other([&] { cpu(1, right); });
  cpu(0, left);
  other.join();
}

}  // namespace front_end_detail

// In the constructors of Frame, whose extractors may have no front end.

/// @param cpu ExtractORB of an image: of camera 0 or 1, and the image
template <typename Types, typename Cpu, typename... Images>
void extract(front_end<Types>* gpu, typename Types::frame& frame, Cpu const& cpu,
             Images const&... images) {
  auto const all = [&] { front_end_detail::extract(cpu, images...); };
  gpu == nullptr ? all() : gpu->extract(frame, all, images...);
}
/// @param cpu ComputeStereoMatches or ComputeStereoFishEyeMatches
template <typename Types, typename Cpu>
void stereo(front_end<Types>* gpu, typename Types::frame& frame, Cpu const& cpu) {
  gpu == nullptr ? cpu() : gpu->stereo(frame, cpu);
}

/// Defined by the unit that includes make_tracker.hpp.
std::unique_ptr<device_tracker> make_tracker(settings const& s);

/// Whether this thread is in ORB-SLAM3's own code that a front_end has called.
inline bool& in_own_code() {
  thread_local bool is = false;
  return is;
}
/// For a hook at the beginning of one of ORB-SLAM3's functions: the front end of a frame's left
/// extractor, or nullptr where the rest of the function is to run.
template <typename Frame>
auto hooked(Frame const& frame) -> decltype(frame.mpORBextractorLeft->mpGpu) {
  bool const own = in_own_code() || frame.mpORBextractorLeft == nullptr;
  return own ? nullptr : frame.mpORBextractorLeft->mpGpu;
}

/// Every call takes the CPU's own code as a callable, `cpu`, which must give the same result. No
/// exception leaves these functions: the first failure is printed on stderr, and from then on the
/// CPU runs all stages. A frame that is refused (see frame_refused) is the CPU's in those stages
/// that cannot take it; the reason is printed once, and the next frame is the accelerator's again.
/// Constructed at the first image, when everything that settings_of() takes is known.
/// @tparam Types with frame, map_point and, for settings_of(), fisheye_camera
template <typename Types>
class front_end {
public:
  using types = Types;
  using frame_type = typename Types::frame;
  using map_point = typename Types::map_point;

  /// Poses are the CPU's, unless FT_ORBSLAM3_HOST names other stages, or "none".
  /// @param make_settings called for the settings
  /// @param detection hooks if they are compiled in, unless FT_ORBSLAM3_COMPARE=1; the other
  ///   options come from the environment
  /// @param vocabulary see options::vocabulary
  template <typename MakeSettings>
  front_end(MakeSettings const& make_settings, change_detection detection,
            std::string const& vocabulary = {}) {
    attempt([&] {
      options o;
      set_modes(o, "poses", stage_mode::host);
      o.detection = detection;
      o.vocabulary = vocabulary;
      o = from_environment(o);
      settings const s = make_settings();
      start(make_tracker(s), s, o);
    });
  }
  /// With a given tracker and options.
  front_end(std::unique_ptr<device_tracker> device, settings const& s, options const& o) {
    attempt([&] { start(std::move(device), s, o); });
  }
  front_end(front_end const&) = delete;
  front_end& operator=(front_end const&) = delete;

  /// Whether the accelerator runs a stage.
  bool uses(stage s) const { return works_ && gpu_->uses(s); }
  /// For the hooks; nullptr if no changes need to be pushed. After this object is gone it is
  /// closed: pushes do nothing.
  std::shared_ptr<change_queue<map_point>> changes() const {
    return works_ ? gpu_->shared_changes() : nullptr;
  }
  /// At each image, by the tracking thread: sends the changes of these maps' points here, and wakes
  /// the threads that extract() needs.
  /// @param maps Atlas::GetAllMaps(): pointers to maps that have a map_changes `mChanges`
  template <typename Maps>
  void watch(Maps const& maps) {
    if (!works_) { return; }
    for (auto* const map : maps) { map->mChanges.send_to(gpu_->shared_changes()); }
    gpu_->expect_images();
  }

  // ---- in the constructors of Frame

  /// Features of one or two images. @param cpu ExtractORB of all of them
  template <typename Cpu, typename... Images>
  void extract(frame_type& frame, Cpu const& cpu, Images const&... images) {
    run(uses(stage::extract), cpu,
        [&] { both_ ? both_->extract(frame, cpu, images...) : gpu_->extract(images..., frame); });
  }
  /// Frame::ComputeStereoMatches and ComputeStereoFishEyeMatches of what extract() has filled.
  /// Frames with features of the CPU have the CPU's stereo.
  template <typename Cpu>
  void stereo(frame_type& frame, Cpu const& cpu) {
    bool const here = uses(stage::stereo) && gpu_->extracted(frame);
    if (!here || both_ != nullptr || gpu_->two_cameras()) {
      return run(here, cpu,
                 [&] { both_ ? both_->stereo(frame, cpu) : gpu_->compute_stereo(frame); });
    }
    // Where the device fails here, one frame is without stereo: the CPU's has no image pyramids.
    run(
        true, [&] { frame.mvuRight = frame.mvDepth = std::vector<float>(frame.mvKeys.size(), -1); },
        [&] { gpu_->compute_stereo(frame); });
  }

  // ---- in Tracking; each returns the value of `cpu`

  /// @param cpu ORBmatcher::SearchByProjection with these arguments
  template <typename Cpu>
  int search_by_projection(frame_type& current, frame_type const& last, float th, bool mono,
                           Cpu const& cpu) {
    next_pose_ = stage::pose_last_frame;
    return either(stage::search_last_frame, cpu, [&](auto& by, auto const&... with) {
      return by.search_by_projection(current, last, th, mono, with...);
    });
  }
  /// @param cpu frustum test of all points and ORBmatcher::SearchByProjection of those in view
  template <typename Cpu>
  int search_local_points(frame_type& frame, std::vector<map_point*> const& points, float th,
                          bool far_points, float far_threshold, Cpu const& cpu) {
    next_pose_ = stage::pose_local_map;
    return either(stage::search_local_map, cpu, [&](auto& by, auto const&... with) {
      return by.search_local_points(frame, points, th, far_points, far_threshold, with...);
    });
  }
  /// The stage is that of the search before: of the last frame, of the local map, or any other.
  /// @param cpu Optimizer::PoseOptimization
  template <typename Cpu>
  int pose_optimization(frame_type& frame, Cpu const& cpu) {
    return pose_optimization(frame, std::exchange(next_pose_, stage::pose_keyframe), cpu);
  }
  template <typename Cpu>
  int pose_optimization(frame_type& frame, stage which, Cpu const& cpu) {
    return either(which, cpu, [&](auto& by, auto const&... with) {
      return by.pose_optimization(frame, which, with...);
    });
  }
  /// Where the frame lacks what it starts from, or a number is not finite, the CPU's own code
  /// decides what becomes of that frame. The accelerator goes on with the next one.
  /// @param cpu Optimizer::PoseInertialOptimizationLastFrame or ...LastKeyFrame, as `which` says
  template <typename Cpu>
  int inertial_pose_optimization(frame_type& frame, stage which, Cpu const& cpu) {
    return either(which, cpu, [&](auto& by, auto const&... with) {
      return by.inertial_pose_optimization(frame, which, with...);
    });
  }
  /// From any thread: mapping computes the words of keyframes.
  /// @param cpu Frame::ComputeBoW or KeyFrame::ComputeBoW
  template <typename Frame, typename Cpu>
  void compute_bow(Frame& frame, Cpu const& by_cpu) {
    auto const cpu = own_code(by_cpu);
    run(frame.mBowVec.empty() && uses(stage::transform) && gpu_->can_compute_bow(frame), cpu, [&] {
      verified(stage::transform) ? both_->compute_bow(frame, cpu) : gpu_->compute_bow(frame);
    });
  }
  /// Without words of both, the CPU's own code searches.
  /// @param ratio,orientation_check the arguments of ORBmatcher
  /// @param cpu ORBmatcher::SearchByBoW of the keyframe and the frame, into `matches`
  template <typename KeyFrame, typename Cpu>
  int search_by_bow(KeyFrame& keyframe, frame_type const& frame, std::vector<map_point*>& matches,
                    float ratio, bool orientation_check, Cpu const& cpu) {
    next_pose_ = stage::pose_keyframe;
    return either(stage::search_by_bow, cpu, [&](auto& by, auto const&... with) {
      return by.search_by_bow(keyframe, frame, matches, ratio, orientation_check, with...);
    });
  }
  /// Where the frame lacks descriptors, or there is no room, the CPU's own code searches.
  /// @param found map points that are not searched: std::set<MapPoint*>
  /// @param cpu ORBmatcher(0.9, true).SearchByProjection with these arguments
  template <typename KeyFrame, typename Found, typename Cpu>
  int search_keyframe(frame_type& frame, KeyFrame& keyframe, Found const& found, float th,
                      int max_distance, Cpu const& cpu) {
    return either(stage::search_keyframe, cpu, [&](auto& by, auto const&... with) {
      return by.search_keyframe(frame, keyframe, found, th, max_distance, with...);
    });
  }

  /// To be called before a map point is deleted.
  void forget(map_point const* point) {
    if (works_) { gpu_->forget(point); }
  }
  /// In Tracking::Reset and ResetActiveMap.
  void reset() {
    if (works_) { gpu_->reset(); }
  }

  /// Prints the summary of verify, if enabled, and how many calls were refused; at the end.
  void print(std::ostream& out) {
    if (both_ != nullptr) { both_->summary(out); }
    if (refused_ > 0) { out << "ft: " << refused_ << " calls were refused\n"; }
  }

private:
  void start(std::unique_ptr<device_tracker> device, settings const& s, options o) {
    // The CPU's stereo of a rectified pair needs the CPU's image pyramids.
    bool const pyramids = s.images == 2 && s.left.kind == lens::pinhole;
    if (pyramids && o[stage::stereo] == stage_mode::host) { o[stage::extract] = stage_mode::host; }
    gpu_ = std::make_unique<accelerator<Types>>(std::move(device), s, o);
    load_vocabulary(o);
    if (o.verify) {
      both_ = std::make_unique<verifier<Types>>(*gpu_, nullptr);
      both_->print_frames(std::cerr);
    }
    works_ = true;
  }
  /// Without a vocabulary only the transform stays the CPU's.
  void load_vocabulary(options const& o) {
    if (o.vocabulary.empty() || o[stage::transform] == stage_mode::host) { return; }
    try {
      gpu_->load_vocabulary(o.vocabulary);
    } catch (std::exception const& e) { say(e.what(), "finds the words"); }
  }
  /// @return whether it succeeded
  template <typename Call>
  bool attempt(Call const& call) {
    try {
      call();
      return true;
    } catch (frame_refused const& e) {
      refuse(e.what());
      return false;
    } catch (std::exception const& e) { say(e.what(), "tracks from here on"); }
    works_ = false;
    if (gpu_ != nullptr) { gpu_->changes().close(); }
    return false;
  }
  /// Each reason is printed once, up to ten of them.
  void refuse(std::string const& reason) {
    ++refused_;
    if (reasons_.size() < 10 && reasons_.insert(reason).second) { say(reason, "takes this frame"); }
  }
  static void say(std::string const& reason, char const* what) {
    bool const ours = reason.rfind("ft: ", 0) == 0;
    std::cerr << (ours ? "" : "ft: ") << reason << "; ORB-SLAM3's own code " << what << "\n";
  }
  /// Calls `here` if the accelerator runs a stage, otherwise or if that fails `cpu`.
  template <typename Cpu, typename Here>
  void run(bool runs, Cpu const& cpu, Here const& here) {
    if (!runs || !attempt(here)) { cpu(); }
  }
  /// @param by_cpu calls ORB-SLAM3's own function: a hook at its beginning must let it pass
  template <typename Cpu>
  static auto own_code(Cpu const& by_cpu) {
    return [&by_cpu] {
      struct restored {
        bool before = std::exchange(in_own_code(), true);
        ~restored() { in_own_code() = before; }
      } const inside;
      return by_cpu();
    };
  }
  /// @param call makes the call by the accelerator, or by the verifier with `cpu`. What the
  ///   accelerator refuses is the CPU's
  template <typename Cpu, typename Call>
  int either(stage s, Cpu const& by_cpu, Call const& call) {
    auto const cpu = own_code(by_cpu);
    int answer = call_refused;
    run(
        uses(s), [] {}, [&] { answer = verified(s) ? call(*both_, cpu) : call(*gpu_); });
    return answer == call_refused ? cpu() : answer;
  }
  bool verified(stage s) const {
    return both_ != nullptr && gpu_->chosen()[s] == stage_mode::device;
  }

  std::unique_ptr<accelerator<Types>> gpu_;  ///< kept after a failure: the hooks use its queue
  std::unique_ptr<verifier<Types>> both_;
  std::atomic<bool> works_{false};          ///< mapping reads it, too
  stage next_pose_ = stage::pose_keyframe;  ///< that the last search says
  std::atomic<int> refused_{0};             ///< calls
  std::set<std::string> reasons_;
};

/// Protected members, which a derived class may name.
template <typename Extractor>
struct opened_extractor : Extractor {
  static extractor_parameters parameters_of(Extractor& e) {
    return {e.*(&opened_extractor::nfeatures), e.GetScaleFactor(), e.GetLevels(),
            e.*(&opened_extractor::iniThFAST), e.*(&opened_extractor::minThFAST)};
  }
};
template <typename Tracking>
struct opened_tracking : Tracking {
  template <typename Image>
  static void follow(Tracking& t, Image const& image) {
    using opened = opened_tracking;
    using front = typename std::decay_t<decltype(t.mpGpu)>::element_type;
    auto* const extractor = t.*(&opened::mpORBextractorLeft);
    auto const make_settings = [&] {
      using opened_features = opened_extractor<std::decay_t<decltype(*extractor)>>;
      return settings_of<typename front::types>(
          opened_features::parameters_of(*extractor), t.mSensor, image, t.*(&opened::mbf),
          t.*(&opened::mpCamera), t.*(&opened::mpCamera2), t.*(&opened::mTlr));
    };
    if (t.mpGpu == nullptr && !image.empty()) {
      t.mpGpu = std::make_unique<front>(make_settings, change_detection::hooks, t.mGpuVocabulary);
    }
    if (t.mpGpu != nullptr) { t.mpGpu->watch((t.*(&opened::mpAtlas))->GetAllMaps()); }
    extractor->mpGpu = t.mpGpu.get();
  }
};

/// In Tracking, before a frame is made of an image: makes Tracking::mpGpu when the first image that
/// is not empty tells the size, gives it to the left extractor, and sends the changes of all maps'
/// points there. Reads the members of Tracking and ORBextractor that settings_of() takes.
template <typename Tracking, typename Image>
void follow(Tracking& tracking, Image const& image) {
  opened_tracking<Tracking>::follow(tracking, image);
}

}  // namespace ft::orbslam3
