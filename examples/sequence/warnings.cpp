// SPDX-License-Identifier: Apache-2.0
#include "examples/sequence/warnings.hpp"

#include <algorithm>
#include <cstddef>
#include <cstdint>
#include <cstring>
#include <utility>

#include "examples/sequence/report_figures.hpp"

namespace seq {
namespace {

/// Frames in a row without a pose.
struct loss {
  int first_index = 0;
  double seconds = 0;
};

/// The first frame with a pose; 0 if none has one.
std::size_t first_tracked(std::vector<frame_record> const& records) {
  std::size_t i = 0;
  while (i < records.size() && !records[i].tracked) { ++i; }
  return i < records.size() ? i : 0;
}

double seconds_between(frame_record const& from, frame_record const& to) {
  return 1e-9 * static_cast<double>(to.time_ns - from.time_ns);
}

/// The longest loss after tracking began, from its first frame to the frame after it, or to the
/// last one.
loss longest_loss(std::vector<frame_record> const& records) {
  loss longest;
  for (std::size_t i = first_tracked(records); i < records.size();) {
    if (records[i].tracked) {
      ++i;
      continue;
    }
    std::size_t end = i;
    while (end + 1 < records.size() && !records[end].tracked) { ++end; }
    double const s = seconds_between(records[i], records[end]);
    if (s > longest.seconds) { longest = {records[i].index, s}; }
    i = end + 1;
  }
  return longest;
}

/// Share of all keypoints with a stereo match; 1 without keypoints.
double stereo_share(std::vector<frame_record> const& records) {
  std::int64_t keypoints = 0;
  std::int64_t matches = 0;
  for (frame_record const& r : records) {
    keypoints += r.keypoints;
    matches += r.stereo_matches;
  }
  return keypoints == 0 ? 1.0 : static_cast<double>(matches) / static_cast<double>(keypoints);
}

/// The fastest motion between two poses in a row.
struct fastest_step {
  std::size_t to = 0;
  double speed = 0;  ///< m/s
};
fastest_step fastest_of(trajectory const& poses) {
  fastest_step fastest;
  for (std::size_t i = 1; i < poses.size(); ++i) {
    double const s = 1e-9 * static_cast<double>(poses[i].time_ns - poses[i - 1].time_ns);
    double const speed =
        (poses[i].T_world_camera.translation() - poses[i - 1].T_world_camera.translation()).norm() /
        s;
    if (speed > fastest.speed) { fastest = {i, speed}; }
  }
  return fastest;
}

/// Names that frames have, in the order of their first frames.
class named_frames {
public:
  void add(std::string const& name, std::string const& said, int index) {
    auto at = std::find_if(all_.begin(), all_.end(),
                           [&](entry const& known) { return known.name == name; });
    if (at == all_.end()) { at = all_.insert(all_.end(), {name, said, index, 0}); }
    ++at->frames;
  }
  template <typename Condition>
  void forget_if(Condition const& condition) {
    all_.erase(std::remove_if(all_.begin(), all_.end(),
                              [&](entry const& known) { return condition(known.name); }),
               all_.end());
  }
  std::vector<std::string> sentences(std::size_t frames) const {
    std::vector<std::string> out;
    for (entry const& e : all_) {
      out.push_back(e.name + " in " + std::to_string(e.frames) + " of " + std::to_string(frames) +
                    " frames, first in frame " + std::to_string(e.first) + ": " + e.said);
    }
    return out;
  }

private:
  struct entry {
    std::string name, said;
    int first = 0;
    int frames = 0;
  };
  std::vector<entry> all_;
};

/// What sentences that differ in numbers alone have in common.
std::string without_numbers(std::string text) {
  auto const in_number = [](char c) { return std::strchr("0123456789.e+-", c) != nullptr; };
  text.erase(std::remove_if(text.begin(), text.end(), in_number), text.end());
  return text;
}

/// What is said of a path that is longer or shorter than the ground truth by a factor.
std::string scale_sentence(run_report const& report) {
  std::string const cause = report.one_camera ? "the IMU's samples, or where it is, may be wrong"
                            : report.depth_images
                                ? "is the unit of depths another one (--depth-unit)?"
                                : "is the baseline another one, or in another unit?";
  return "the path has the ground truth's shape, not its scale: its lengths times " +
         detail::fixed(report.fit->scale, 3) + " would fit, and then the RMSE is " +
         detail::fixed(report.fit->error_m, 3) + " m: " + cause;
}

}  // namespace

std::vector<std::string> reasons_of(run_report const& report) {
  named_frames all;
  for (frame_record const& r : report.records) {
    if (!r.reason.empty()) { all.add(r.reason, r.why, r.index); }
  }
  return all.sentences(report.records.size());
}

std::vector<std::string> frame_warnings_of(run_report const& report) {
  named_frames all;
  auto const is_reason = [&](std::string const& name) {
    return std::any_of(report.records.begin(), report.records.end(),
                       [&](frame_record const& r) { return r.reason == name; });
  };
  for (frame_record const& r : report.records) {
    for (auto const& [name, said] : r.warnings) { all.add(name, said, r.index); }
  }
  all.forget_if(is_reason);
  return all.sentences(report.records.size());
}

std::vector<std::string> imu_warnings_of(run_report const& report) {
  struct kind {
    std::string words, said;
    bool counts_all = false;  // samples of the frames before, too
    int first = 0;
    int frames = 0;
  };
  auto const has = [](std::string const& text, char const* part) {
    return text.find(part) != std::string::npos;
  };
  char const* const rate = "rate_hz says";  // also said of the recording
  bool const rate_said = std::any_of(report.warnings.begin(), report.warnings.end(),
                                     [&](std::string const& w) { return has(w, rate); });
  std::vector<kind> all;  // in the order of their first frames
  for (frame_record const& r : report.records) {
    for (std::string const& said : r.imu_warnings) {
      if (rate_said && has(said, rate)) { continue; }
      std::string const words = without_numbers(said);
      auto at = std::find_if(all.begin(), all.end(),
                             [&](kind const& known) { return known.words == words; });
      if (at == all.end()) {
        at = all.insert(all.end(), {words, said, has(said, "left out"), r.index});
      }
      if (at->counts_all) { at->said = said; }
      ++at->frames;
    }
  }
  std::vector<std::string> out;
  for (kind const& k : all) {
    std::string const where = k.counts_all ? "; first in frame "
                                           : "; in " + std::to_string(k.frames) + " of " +
                                                 std::to_string(report.records.size()) +
                                                 " frames, first in frame ";
    out.push_back(k.said + where + std::to_string(k.first));
  }
  return out;
}

std::vector<std::string> warnings_of(run_report const& report) {
  using detail::fixed;
  std::vector<std::string> out;
  if (report.stopped_at) {
    out.push_back("stopped at frame " + std::to_string(*report.stopped_at) + ": " +
                  report.stopped_by);
  }
  for (std::string const& found : report.calibration) { out.push_back("calibration: " + found); }
  double const share = stereo_share(report.records);
  // Most cameras of a rig have no partners, and those of a pair that is not rectified have few.
  auto const rig = report.options.find("rig");
  bool const mixed = rig != report.options.end() && rig->second == "mixed";
  if (!report.one_camera && !mixed && share < least_stereo_share) {
    out.push_back(
        "only " + fixed(100 * share, 1) +
        (report.depth_images
             ? " % of the keypoints have a depth: the depth images may be nearly empty, or "
               "their unit or range is another one"
             : " % of the keypoints have a stereo match: left and right may be exchanged, "
               "or the calibration is that of other cameras"));
  }
  if (report.unpaired_left > 0 || report.unpaired_right > 0) {
    out.push_back(
        "images without a partner were left out: " + std::to_string(report.unpaired_left) +
        (report.depth_images ? " of the camera, " : " of the left camera, ") +
        std::to_string(report.unpaired_right) +
        (report.depth_images ? " depth images" : " of the right one"));
  }
  if (report.loaded_map && report.loaded_map->found_after == 0) {
    out.push_back("the camera was not found in the map " + report.loaded_map->file +
                  ": its poses are not in the world of that map");
  }
  if (int const maps = report.loops ? report.loops->maps : report.maps; maps > 1) {
    out.push_back(std::to_string(maps) +
                  " maps were begun: a map after the first starts at a guessed pose, so the path "
                  "is not of one piece");
  }
  if (std::size_t const first = first_tracked(report.records); first > 0) {
    double const s = seconds_between(report.records.front(), report.records[first]);
    if (s > longest_loss_s) {
      out.push_back("tracking began after " + fixed(s, 1) + " s, in frame " +
                    std::to_string(report.records[first].index));
    }
  }
  if (loss const l = longest_loss(report.records); l.seconds > longest_loss_s) {
    out.push_back("tracking was lost for " + fixed(l.seconds, 1) + " s from frame " +
                  std::to_string(l.first_index) + " on");
  }
  for (std::string& said : imu_warnings_of(report)) { out.push_back(std::move(said)); }
  for (std::string const& reason : reasons_of(report)) {
    // One camera always waits for motion, at first.
    bool const usual = report.tracked > 0 && reason.rfind("awaits_motion ", 0) == 0;
    if (!usual) { out.push_back(reason); }
  }
  for (std::string& said : frame_warnings_of(report)) { out.push_back(std::move(said)); }
  if (report.fit && report.fit->off_by(most_off_scale)) { out.push_back(scale_sentence(report)); }
  fastest_step const fastest = fastest_of(report.estimate);
  if ((report.metric || report.scale) && fastest.speed > largest_speed) {
    out.push_back("the camera moves at " + fixed(fastest.speed, 1) + " m/s before pose " +
                  std::to_string(fastest.to) + ", above " + fixed(largest_speed, 0) +
                  " m/s: is the baseline, or the depth, in metres, and are stamps in nanoseconds?");
  }
  return out;
}

}  // namespace seq
