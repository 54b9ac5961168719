// SPDX-License-Identifier: Apache-2.0
#include "examples/sequence/warnings.hpp"

#include <cstddef>
#include <cstdint>

#include "examples/sequence/report_figures.hpp"

namespace seq {
namespace {

/// Frames in a row without a pose.
struct loss {
  int first_index = 0;
  double seconds = 0;
};

/// The longest loss, from its first frame to the frame after it, or to the last one.
loss longest_loss(std::vector<frame_record> const& records) {
  loss longest;
  for (std::size_t i = 0; i < records.size();) {
    if (records[i].tracked) {
      ++i;
      continue;
    }
    std::size_t end = i;
    while (end + 1 < records.size() && !records[end].tracked) { ++end; }
    double const s = 1e-9 * static_cast<double>(records[end].time_ns - records[i].time_ns);
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

}  // namespace

std::vector<std::string> warnings_of(run_report const& report) {
  using detail::fixed;
  std::vector<std::string> out;
  if (report.stopped_at) {
    out.push_back("stopped at frame " + std::to_string(*report.stopped_at) + ": " +
                  report.stopped_by);
  }
  double const share = stereo_share(report.records);
  if (!report.one_camera && share < least_stereo_share) {
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
  if (report.maps > 1) {
    out.push_back(std::to_string(report.maps) +
                  " maps were begun: a map after the first starts at a guessed pose, so the path "
                  "is not of one piece");
  }
  if (loss const l = longest_loss(report.records); l.seconds > longest_loss_s) {
    out.push_back("tracking was lost for " + fixed(l.seconds, 1) + " s from frame " +
                  std::to_string(l.first_index) + " on");
  }
  return out;
}

}  // namespace seq
