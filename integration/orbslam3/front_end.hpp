// SPDX-License-Identifier: Apache-2.0
/// @file The functions that ORB-SLAM3's files call. Each stage runs on the accelerator, in
/// ORB-SLAM3's own code, or in both to compare them.
#pragma once

#include <atomic>
#include <cstddef>
#include <exception>
#include <iostream>
#include <memory>
#include <ostream>
#include <set>
#include <string>
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

template <typename Types, typename Cpu, typename... Images>
void extract(front_end<Types>* gpu, typename Types::frame& frame, Cpu const& cpu,
             Images const&... images) {
  gpu == nullptr ? cpu() : gpu->extract(frame, cpu, images...);
}
template <typename Types, typename Cpu>
void undistort(front_end<Types>* gpu, typename Types::frame& frame, Cpu const& cpu) {
  gpu == nullptr ? cpu() : gpu->undistort(frame, cpu);
}
template <typename Types, typename Cpu>
void assign_to_grid(front_end<Types>* gpu, typename Types::frame& frame, Cpu const& cpu) {
  gpu == nullptr ? cpu() : gpu->assign_to_grid(frame, cpu);
}
template <typename Types, typename Cpu, typename Image>
void stereo(front_end<Types>* gpu, typename Types::frame& frame, Cpu const& cpu,
            std::vector<Image>& left, std::vector<Image>& right) {
  gpu == nullptr ? cpu() : gpu->stereo(frame, cpu, left, right);
}
template <typename Types, typename Cpu>
void stereo_fisheye(front_end<Types>* gpu, typename Types::frame& frame, Cpu const& cpu) {
  gpu == nullptr ? cpu() : gpu->stereo_fisheye(frame, cpu);
}

/// Defined by the unit that includes make_tracker.hpp.
std::unique_ptr<device_tracker> make_tracker(settings const& s);

struct no_vocabulary {};

/// Every call takes the CPU's own code as a callable, `cpu`, which must give the same result. No
/// exception leaves these functions: the first failure is printed on stderr, and from then on the
/// CPU runs all stages. A frame that is refused (see frame_refused) is the CPU's in those stages
/// that cannot take it; the reason is printed once, and the next frame is the accelerator's again.
/// Constructed at the first image, when everything that settings_of() takes is known.
/// @tparam Types with frame, map_point and, for settings_of(), fisheye_camera
template <typename Types>
class front_end {
public:
  using frame_type = typename Types::frame;
  using map_point = typename Types::map_point;

  /// Poses are the CPU's, unless FT_ORBSLAM3_HOST names other stages, or "none".
  /// @param make_settings called for the settings
  /// @param detection hooks if they are compiled in, unless FT_ORBSLAM3_COMPARE=1; the other
  ///   options come from the environment
  /// @param vocabulary see options::vocabulary; FT_ORBSLAM3_VOCABULARY replaces it
  /// @param theirs ORBVocabulary, which must have the same words; nullptr: is not compared
  template <typename MakeSettings, typename Vocabulary = no_vocabulary>
  front_end(MakeSettings const& make_settings, change_detection detection,
            std::string const& vocabulary = {}, Vocabulary const* theirs = nullptr) {
    attempt([&] {
      options o;
      set_modes(o, "poses", stage_mode::host);
      o.detection = detection;
      o.vocabulary = vocabulary;
      o = from_environment(o);
      settings const s = make_settings();
      start(make_tracker(s), s, o, theirs);
    });
  }
  /// With a given tracker and options.
  template <typename Vocabulary = no_vocabulary>
  front_end(std::unique_ptr<device_tracker> device, settings const& s, options const& o,
            Vocabulary const* theirs = nullptr) {
    attempt([&] { start(std::move(device), s, o, theirs); });
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
  /// At each image, by the tracking thread: sends the changes of these maps' points here.
  /// @param maps Atlas::GetAllMaps(): pointers to maps that have a map_changes `mChanges`
  template <typename Maps>
  void watch(Maps const& maps) {
    if (!works_) { return; }
    for (auto* const map : maps) { map->mChanges.send_to(gpu_->shared_changes()); }
  }

  /// In System::TrackStereo, before it copies or rectifies the images: wakes the threads that
  /// extract() needs. Does not wait for them.
  void expect_images() {
    if (uses(stage::extract)) { gpu_->expect_images(); }
  }

  // ---- in the constructors of Frame

  /// Features of one or two images. @param cpu ExtractORB of all of them
  template <typename Cpu, typename... Images>
  void extract(frame_type& frame, Cpu const& cpu, Images const&... images) {
    run(uses(stage::extract), cpu,
        [&] { both_ ? both_->extract(frame, cpu, images...) : gpu_->extract(images..., frame); });
  }
  /// mvKeysUn. @param cpu UndistortKeyPoints
  template <typename Cpu>
  void undistort(frame_type& frame, Cpu const& cpu) {
    run(uses(stage::undistort) && gpu_->can_undistort(frame), cpu,
        [&] { both_ ? both_->undistort(frame, cpu) : gpu_->undistort(frame); });
  }
  /// mGrid and mGridRight. @param cpu AssignFeaturesToGrid
  template <typename Cpu>
  void assign_to_grid(frame_type& frame, Cpu const& cpu) {
    run(uses(stage::grid), cpu,
        [&] { both_ ? both_->assign_to_grid(frame, cpu) : gpu_->assign_to_grid(frame); });
  }
  /// Frame::ComputeStereoMatches. @param left,right the extractors' mvImagePyramid
  template <typename Cpu, typename Image>
  void stereo(frame_type& frame, Cpu const& cpu, std::vector<Image>& left,
              std::vector<Image>& right) {
    // The CPU's pyramids are those of this frame if the CPU has extracted it as well.
    bool const here = works_ && gpu_->extracted(frame);
    bool const pyramids = !here || both_ != nullptr;
    auto const on_gpu = [&] {
      if (here) {
        gpu_->compute_stereo_matches(frame);
      } else {
        gpu_->compute_stereo_matches(frame, left, right);
      }
    };
    run_stereo(frame, cpu, on_gpu, [&] {
      if (pyramids || (works_ && attempt([&] {
                         gpu_->download_pyramid(0, left);
                         gpu_->download_pyramid(1, right);
                       }))) {
        return cpu();
      }
      // The accelerator has failed in between: one frame without stereo.
      frame.mvuRight.assign(frame.mvKeys.size(), -1.0f);
      frame.mvDepth.assign(frame.mvKeys.size(), -1.0f);
    });
  }
  /// Frame::ComputeStereoFishEyeMatches.
  template <typename Cpu>
  void stereo_fisheye(frame_type& frame, Cpu const& cpu) {
    run_stereo(
        frame, cpu, [&] { gpu_->compute_stereo_fisheye_matches(frame); }, cpu);
  }

  // ---- in Tracking; each returns the value of `cpu`

  /// @param cpu ORBmatcher::SearchByProjection with these arguments
  template <typename Cpu>
  int search_by_projection(frame_type& current, frame_type const& last, float th, bool mono,
                           Cpu const& cpu) {
    return either(stage::search_last_frame, cpu, [&](auto& by, auto const&... with) {
      return by.search_by_projection(current, last, th, mono, with...);
    });
  }
  /// Runs on the CPU also while memory for a larger local map is being allocated.
  /// @param cpu frustum test of all points and ORBmatcher::SearchByProjection of those in view
  template <typename Cpu>
  int search_local_points(frame_type& frame, std::vector<map_point*> const& points, float th,
                          bool far_points, float far_threshold, Cpu const& cpu) {
    if (uses(stage::search_local_map) && !has_room_for(points.size())) { return cpu(); }
    return either(stage::search_local_map, cpu, [&](auto& by, auto const&... with) {
      return by.search_local_points(frame, points, th, far_points, far_threshold, with...);
    });
  }
  /// @param cpu Optimizer::PoseOptimization
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
    if (uses(which) && !gpu_->can_optimize_inertial(frame, which)) { return cpu(); }
    return either(which, cpu, [&](auto& by, auto const&... with) {
      return by.inertial_pose_optimization(frame, which, with...);
    });
  }
  /// From any thread: mapping computes the words of keyframes.
  /// @param cpu Frame::ComputeBoW or KeyFrame::ComputeBoW
  template <typename Frame, typename Cpu>
  void compute_bow(Frame& frame, Cpu const& cpu) {
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

  /// Prints statistics and the summary of verify, if enabled; at the end.
  void print(std::ostream& out) {
    if (gpu_ != nullptr && gpu_->chosen().statistics) { orbslam3::print(out, gpu_->times()); }
    if (both_ != nullptr) { both_->summary(out); }
    if (refused_ > 0) { out << "ft: " << refused_ << " calls were refused\n"; }
  }

private:
  template <typename Vocabulary>
  void start(std::unique_ptr<device_tracker> device, settings const& s, options const& o,
             Vocabulary const* theirs) {
    gpu_ = std::make_unique<accelerator<Types>>(std::move(device), s, o);
    load_vocabulary(o, theirs);
    if (o.verify) {
      both_ = std::make_unique<verifier<Types>>(*gpu_, nullptr);
      both_->print_frames(std::cerr);
    }
    works_ = true;
  }
  /// Without a vocabulary only the transform stays the CPU's.
  template <typename Vocabulary>
  void load_vocabulary(options const& o, Vocabulary const* theirs) {
    if (o.vocabulary.empty() || o[stage::transform] == stage_mode::host) { return; }
    try {
      if constexpr (!std::is_same_v<Vocabulary, no_vocabulary>) {
        if (theirs != nullptr) {
          vocabulary_facts const facts = facts_of(*theirs);
          return gpu_->load_vocabulary(o.vocabulary, &facts);
        }
      }
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
  bool has_room_for(std::size_t points) {
    bool room = false;
    attempt([&] { room = gpu_->has_room_for(points); });
    if (works_ && !room && points > most_told_) {
      most_told_ = points;
      std::cerr << "ft: ORB-SLAM3's own code searches a local map of " << points
                << " points while memory for it is allocated (settings::local_points)\n";
    }
    return room;
  }
  /// Calls `here` if the accelerator runs a stage, otherwise or if that fails `cpu`.
  template <typename Cpu, typename Here>
  void run(bool runs, Cpu const& cpu, Here const& here) {
    if (!runs || !attempt(here)) { cpu(); }
  }
  /// @param otherwise called where the accelerator has no stereo
  template <typename Cpu, typename Gpu, typename Otherwise>
  void run_stereo(frame_type& frame, Cpu const& cpu, Gpu const& on_gpu,
                  Otherwise const& otherwise) {
    run(uses(stage::stereo), otherwise,
        [&] { both_ ? both_->stereo(frame, cpu, on_gpu) : on_gpu(); });
  }
  /// @param call makes the call by the accelerator, or by the verifier with `cpu`. What the
  ///   accelerator refuses is the CPU's
  template <typename Cpu, typename Call>
  int either(stage s, Cpu const& cpu, Call const& call) {
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
  std::atomic<bool> works_{false};  ///< mapping reads it, too
  std::size_t most_told_ = 0;       ///< points of a local map that had no room
  std::atomic<int> refused_{0};     ///< calls
  std::set<std::string> reasons_;
};

}  // namespace ft::orbslam3
