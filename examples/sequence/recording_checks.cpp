// SPDX-License-Identifier: Apache-2.0
#include "examples/sequence/detail/recording_checks.hpp"

#include <utility>

#include "examples/sequence/calibration.hpp"
#include "examples/sequence/detail/stamps.hpp"
#include "examples/sequence/detail/text.hpp"

namespace seq::detail {
namespace {

/// What the TUM RGB-D recordings have.
constexpr double usual_depth_unit = 1.0 / 5000;

/// Of the pixels that have a depth; 0 without any.
double median_depth(depth_image const& depth, double unit) {
  std::vector<double> seen;
  for (std::uint16_t const value : depth.pixels) {
    if (value > 0) { seen.push_back(unit * value); }
  }
  return median(std::move(seen));
}

}  // namespace

std::string seconds_text(std::int64_t ns) { return to_text(1e-9 * static_cast<double>(ns)); }

void check_overlap(std::vector<frame_files> const& frames, std::int64_t first, std::int64_t last,
                   char const* what, std::vector<std::string>& warnings) {
  std::int64_t const begin = frames.front().time_ns;
  std::int64_t const end = frames.back().time_ns;
  if (first <= end && last >= begin) { return; }
  // Times of today in seconds differ in digits that are not written.
  warnings.push_back(std::string(what) + " and images have no time in common: the former " +
                     (first > end ? "begins " + seconds_text(first - end) + " s after the last"
                                  : "ends " + seconds_text(begin - last) + " s before the first") +
                     " image");
}

void check_frame_times(std::vector<frame_files> const& frames, std::vector<std::string>& warnings) {
  std::vector<std::int64_t> times;
  for (frame_files const& frame : frames) { times.push_back(frame.time_ns); }
  std::int64_t const step = median_step(times);
  constexpr std::int64_t longest = 10'000'000'000;
  constexpr std::int64_t shortest = 100'000;
  if (step == 0 || (step >= shortest && step <= longest)) { return; }
  warnings.push_back("frames are " + seconds_text(step) + " s apart in the median, usual are " +
                     seconds_text(shortest) + " to " + seconds_text(longest) +
                     " s: are the time stamps in another unit?");
}

depth_unit depth_unit_of(layout_of_files const& layout, calibration const& calib,
                         open_options const& options) {
  if (options.depth_unit > 0) { return {options.depth_unit, "as asked for"}; }
  if (calib.depth_unit) { return {*calib.depth_unit, "as the calibration says"}; }
  if (layout.depth_unit > 0) {
    return {layout.depth_unit, std::string("as ") + title_of(layout.name) + " has it"};
  }
  return {usual_depth_unit, "assumed, as TUM RGB-D has it: the calibration says nothing", true,
          layout.of_tum};
}

void check_depths(depth_image const& depth, depth_unit const& unit, std::string const& path,
                  double baseline, std::vector<std::string>& warnings) {
  double const middle = median_depth(depth, unit.metres);
  // The unit is a guess: depths of millimetres would be a fifth of what they are.
  constexpr double least_of_guess = 0.3;
  constexpr double most_of_guess = 50;
  double const farthest = 1000 * baseline;
  constexpr double nearest = 0.05;
  if (middle == 0) { warnings.push_back(path + ": no pixel has a depth"); }
  bool const suits = middle == 0 || (middle >= least_of_guess && middle <= most_of_guess);
  if (unit.assumed && !(unit.known_to_suit && suits)) {
    warnings.push_back(
        path + ": nothing says the unit of the depth images: " + to_text(unit.metres) +
        " m is assumed, as TUM RGB-D has it" +
        (middle > 0 ? ", so that the median depth is " + to_text(middle) + " m" : "") +
        "; of millimetres --depth-unit 0.001 (depth_unit=0.001)" +
        (unit.camera_txt ? ", or a line \"# depth in units of 1 mm\" in camera.txt, says so"
                         : " says so"));
  } else if (middle != 0 && (middle < nearest || middle > farthest)) {
    warnings.push_back(path + ": the median depth is " + to_text(middle) + " m with the unit of " +
                       to_text(unit.metres) + " m, likely are " + to_text(nearest) + " to " +
                       to_text(farthest) + " m: is the unit another one?");
  }
}

}  // namespace seq::detail
