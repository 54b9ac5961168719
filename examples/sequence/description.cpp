// SPDX-License-Identifier: Apache-2.0
#include <cmath>
#include <cstdio>
#include <filesystem>
#include <string>
#include <vector>

#include "examples/sequence/detail/layout.hpp"
#include "examples/sequence/detail/stamps.hpp"
#include "examples/sequence/detail/text.hpp"
#include "examples/sequence/reader.hpp"

namespace seq {
namespace {

using detail::to_text;

char const* lens_name(camera_intrinsics const& camera) {
  switch (camera.model) {
    case lens::radial_tangential:
      return "radial-tangential";
    case lens::kannala_brandt:
      return "Kannala-Brandt";
    case lens::double_sphere:
      return "double sphere";
    case lens::unified:
      return "unified";
    case lens::extended_unified:
      return "extended unified";
    case lens::field_of_view:
      return "field of view";
    case lens::pinhole:
      break;
  }
  return "pinhole";
}

std::string layout_line(sequence const& s) {
  return s.name() + ", " + detail::title_of(s.layout()) + "; calibration " +
         std::filesystem::path(s.source().calibration).filename().string();
}

/// Of a rig whose images are taken as they are.
std::string rig_line(sequence const& s) {
  stereo_rig const& rig = s.raw_rig();
  std::vector<rig_camera> const all = rig_cameras(rig);
  std::string line = std::to_string(all.size()) + " cameras, " + std::to_string(rig.left.width) +
                     "x" + std::to_string(rig.left.height);
  std::vector<bool> right(all.size());
  for (rig_camera const& c : all) {
    if (c.right >= 0) { right[static_cast<std::size_t>(c.right)] = true; }
  }
  for (std::size_t k = 0; k < all.size(); ++k) {
    if (right[k]) { continue; }
    line += "; cam" + std::to_string(k) + " " + lens_name(all[k].camera);
    if (all[k].has_depth) { line += " with depth images"; }
    if (all[k].right < 0) { continue; }
    rig_camera const& other = all[static_cast<std::size_t>(all[k].right)];
    double const apart = (all[k].T_left_this.inverse() * other.T_left_this).translation().norm();
    line += " and cam" + std::to_string(all[k].right) + " " + lens_name(other.camera) + ", " +
            to_text(apart) + " m apart";
  }
  if (s.depth_unit() > 0) {
    line += "; depth " + to_text(s.depth_unit()) + " m a unit, " + s.depth_unit_from();
  }
  return line;
}

std::string cameras_line(sequence const& s) {
  if (s.mixed()) { return rig_line(s); }
  stereo_rig const& raw = s.raw_rig();
  bool const pair = s.kind() == camera_kind::stereo;
  std::string line = pair                            ? "stereo pair"
                     : s.kind() == camera_kind::rgbd ? "one camera with depth images"
                                                     : "one camera";
  line += ", " + std::to_string(raw.left.width) + "x" + std::to_string(raw.left.height) + ", " +
          lens_name(raw.left);
  if (pair && lens_name(raw.right) != std::string(lens_name(raw.left))) {
    line += std::string(" and ") + lens_name(raw.right);
  }
  bool const changed = !s.fisheye() && (pair ? !raw.rectified() : raw.left.model != lens::pinhole);
  if (changed) { line += pair ? ", rectified on load" : ", undistorted on load"; }
  if (pair) { line += ", baseline " + to_text(s.rig().baseline()) + " m"; }
  if (raw.left.readout_s > 0) {
    line += ", rolling shutter of " + to_text(1e3 * raw.left.readout_s) + " ms";
  }
  if (s.kind() == camera_kind::rgbd) {
    line += ", depth " + to_text(s.depth_unit()) + " m a unit, " + s.depth_unit_from();
  }
  return line;
}

std::string images_line(sequence const& s) {
  std::vector<std::int64_t> times;
  for (int i = 0; i < s.size(); ++i) { times.push_back(s.time_ns(i)); }
  std::string line = std::to_string(s.size()) + (s.size() == 1 ? " frame" : " frames");
  std::int64_t const step = detail::median_step(times);
  if (step > 0) {
    char text[64];
    std::snprintf(text, sizeof text, ", %.4g Hz, %.1f s", 1e9 / static_cast<double>(step),
                  1e-9 * static_cast<double>(times.back() - times.front()));
    line += text;
  }
  return line + "; times: " + s.source().stamps;
}

std::string imu_line(sequence const& s, bool asked) {
  if (!asked) { return "not asked for"; }
  auto const& imu = s.imu();
  std::string const& reason = s.source().imu_left_out;
  if (!imu) { return reason.empty() ? "none" : "none: " + reason; }
  std::string line = std::to_string(imu->samples.size()) + " samples, " +
                     to_text(imu->calibration.rate_hz) + " Hz";
  double const offset = imu->calibration.time_offset_s;
  if (offset != 0) {
    line += ", its clock is " + to_text(1e3 * offset) + " ms ahead of the images'";
  }
  return line;
}

std::string truth_line(sequence const& s) {
  if (s.ground_truth().empty()) { return "none"; }
  return std::to_string(s.ground_truth().size()) + " poses" +
         (s.ground_truth_has_orientation() ? "" : ", positions alone");
}

/// Nothing where all was taken; the reasons are warnings.
std::string left_out_line(sequence const& s) {
  unpaired_images const& u = s.unpaired();
  std::string line;
  if (u.left + u.right > 0) {
    line = std::to_string(u.left) + " left and " + std::to_string(u.right) +
           (s.kind() == camera_kind::rgbd ? " depth" : " right") +
           " images without a partner of their time";
  }
  return line;
}

}  // namespace

std::vector<description_line> describe(sequence const& s, bool imu_asked_for) {
  std::vector<description_line> lines = {
      {"sequence", layout_line(s)},
      {"cameras", cameras_line(s) + (s.masked() ? "; masks" : "")},
      {"images", images_line(s)},
      {"imu", imu_line(s, imu_asked_for)},
      {"truth", truth_line(s)}};
  std::string const left_out = left_out_line(s);
  if (!left_out.empty()) { lines.push_back({"left out", left_out}); }
  return lines;
}

}  // namespace seq
