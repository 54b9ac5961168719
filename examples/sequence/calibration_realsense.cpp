// SPDX-License-Identifier: Apache-2.0
#include <algorithm>
#include <set>
#include <string>
#include <vector>

#include "examples/sequence/calibration.hpp"
#include "examples/sequence/detail/calibration_checks.hpp"
#include "examples/sequence/detail/calibration_files.hpp"
#include "examples/sequence/detail/text.hpp"

namespace seq {
namespace {

using namespace detail;

/// What follows `Intrinsic of "NAME" / 848x480 / {Y8}`.
struct stream {
  std::string name;
  std::string formats;
  std::string distortion;
  camera_intrinsics camera;
  std::vector<double> coefficients;
  std::set<std::string> keys;  ///< that were read
};

/// What follows `Extrinsic from "FROM" To "TO" :`: maps points of the one into the other, metres.
struct stated_place {
  std::string from;
  std::string to;
  Eigen::Isometry3d T_to_from = Eigen::Isometry3d::Identity();
};

struct device {
  std::vector<stream> streams;
  std::vector<stated_place> places;
};

bool starts_with(std::string const& text, char const* word) { return text.rfind(word, 0) == 0; }

std::vector<double> numbers(std::string const& text, std::size_t wanted, text_line const& line,
                            std::string const& path) {
  std::vector<std::string> const words = split(text, " \t", true);
  if (words.size() != wanted) {
    fail_at(
        path, line.number,
        "has " + std::to_string(words.size()) + " numbers, must have " + std::to_string(wanted));
  }
  std::vector<double> values;
  for (std::string const& word : words) {
    values.push_back(finite_number(word, path, line.number));
  }
  return values;
}

/// Reads `Key: value` of a stream.
void read_value(text_line const& line, std::string const& path, stream& to) {
  std::size_t const colon = line.text.find(':');
  if (colon == std::string::npos) { return; }
  std::string const key = trim(line.text.substr(0, colon));
  std::string const value = trim(line.text.substr(colon + 1));
  auto const number = [&](limits const& range) {
    double const v = finite_number(value, path, line.number);
    check_number(v, range, path + ":" + std::to_string(line.number), key, value);
    return v;
  };
  to.keys.insert(key);
  if (key == "Width") { to.camera.width = static_cast<int>(number(side_limits)); }
  if (key == "Height") { to.camera.height = static_cast<int>(number(side_limits)); }
  if (key == "PPX") { to.camera.cx = number(centre_limits); }
  if (key == "PPY") { to.camera.cy = number(centre_limits); }
  if (key == "Fx") { to.camera.fx = number(focal_limits); }
  if (key == "Fy") { to.camera.fy = number(focal_limits); }
  if (key == "Distortion") { to.distortion = value; }
  if (key == "Coeffs") { to.coefficients = numbers(value, 5, line, path); }
}

/// Reads rotation (rows) and translation. @return the line after them
std::size_t read_place(std::vector<text_line> const& lines, std::size_t at, std::string const& path,
                       stated_place& to) {
  std::vector<double> rotation;
  for (; at < lines.size(); ++at) {
    std::string const text = trim(lines[at].text);
    if (starts_with(text, "Extrinsic from") || text == "N/A") { break; }
    if (text.empty() || starts_with(text, "Rotation Matrix")) { continue; }
    if (starts_with(text, "Translation Vector:")) {
      if (rotation.size() != 9) { break; }
      Eigen::Map<Eigen::Matrix<double, 3, 3, Eigen::RowMajor> const> const rows(rotation.data());
      to.T_to_from.linear() =
          checked_rotation(rows, path + ":" + std::to_string(lines[at].number), "Rotation Matrix");
      std::vector<double> const t = numbers(text.substr(text.find(':') + 1), 3, lines[at], path);
      to.T_to_from.translation() = Eigen::Vector3d(t[0], t[1], t[2]);
      return at + 1;
    }
    for (double const v : numbers(text, 3, lines[at], path)) { rotation.push_back(v); }
  }
  to.from.clear();  // not available
  return at;
}

device read_device(std::string const& path) {
  device result;
  std::vector<text_line> const lines = read_lines(path);
  stream* open = nullptr;
  for (std::size_t i = 0; i < lines.size();) {
    std::string const text = trim(lines[i].text);
    std::vector<std::string> const parts = split(text, "\"", false);
    if (starts_with(text, "Device info") && !result.streams.empty()) {
      fail_at(path, lines[i].number, "a second device: keep the lines of one");
    }
    if (starts_with(text, "Intrinsic of \"") && parts.size() == 3) {
      result.streams.emplace_back();
      open = &result.streams.back();
      open->name = parts[1];
      open->formats = parts[2];
    } else if (starts_with(text, "Extrinsic from \"") && parts.size() == 5) {
      open = nullptr;
      stated_place found;
      found.from = parts[1];
      found.to = parts[3];
      i = read_place(lines, i + 1, path, found);
      if (!found.from.empty()) { result.places.push_back(found); }
      continue;
    } else if (starts_with(text, "Motion Intrinsic")) {
      open = nullptr;
    } else if (open != nullptr) {
      read_value(lines[i], path, *open);
    }
    ++i;
  }
  return result;
}

void set_lens(stream& s, std::string const& path, std::vector<std::string>& warnings) {
  std::string const where = path + ": \"" + s.name + "\"";
  for (char const* key : {"Width", "Height", "PPX", "PPY", "Fx", "Fy", "Distortion", "Coeffs"}) {
    if (s.keys.count(key) == 0) { throw error(where + ": " + key + " is missing"); }
  }
  bool const zero =
      std::all_of(s.coefficients.begin(), s.coefficients.end(), [](double k) { return k == 0; });
  if (s.distortion == "Kannala Brandt4") {
    set_distortion(s.camera, "equidistant", s.coefficients, where, "Coeffs");
  } else if (s.distortion == "Brown Conrady" || zero) {
    set_distortion(s.camera, "plumb_bob", s.coefficients, where, "Coeffs");
  } else if (s.distortion == "Inverse Brown Conrady") {
    set_distortion(s.camera, "plumb_bob", s.coefficients, where, "Coeffs");
    warnings.push_back(where +
                       ": Inverse Brown Conrady is taken for OpenCV's k1 k2 p1 p2 k3, which is "
                       "close for small coefficients");
  } else {
    throw error(where + ": Distortion is " + s.distortion +
                ": must be Brown Conrady, Inverse Brown Conrady, Kannala Brandt4 or None");
  }
}

/// The intrinsics of a stream at a size. Of several at one size, those of Y8, which is rectified.
camera_intrinsics camera_of(device const& all, std::string const& name, int width, int height,
                            std::string const& path, std::vector<std::string>& warnings) {
  std::string sizes;
  stream const* best = nullptr;
  std::set<std::string> others;
  for (stream const& s : all.streams) {
    if (s.name != name || s.camera.fx == 0) { continue; }
    std::string const size = std::to_string(s.camera.width) + "x" + std::to_string(s.camera.height);
    if (others.insert(size).second) { sizes += (sizes.empty() ? "" : ", ") + size; }
    if (width != 0 && (s.camera.width != width || s.camera.height != height)) { continue; }
    bool const grey = s.formats.find("Y8") != std::string::npos;
    if (best == nullptr || (grey && best->formats.find("Y8") == std::string::npos)) { best = &s; }
  }
  if (best == nullptr) {
    throw error(path + ": no intrinsics of \"" + name + "\"" +
                (sizes.empty() ? std::string()
                               : " at " + std::to_string(width) + "x" + std::to_string(height) +
                                     "; it has " + sizes));
  }
  if (width == 0 && others.size() > 1) {
    throw error(path + ": \"" + name + "\" has intrinsics at " + sizes +
                ", and the images' size is not known");
  }
  stream chosen = *best;
  set_lens(chosen, path, warnings);
  return chosen.camera;
}

stated_place const* place_of(device const& all, std::string const& from, std::string const& to) {
  auto const found = std::find_if(all.places.begin(), all.places.end(), [&](stated_place const& p) {
    return p.from == from && p.to == to;
  });
  return found == all.places.end() ? nullptr : &*found;
}

bool has_stream(device const& all, char const* name) {
  return std::any_of(all.streams.begin(), all.streams.end(),
                     [&](stream const& s) { return s.name == name; });
}

}  // namespace

namespace detail {

bool is_realsense_stream(std::string const& line) {
  return starts_with(line, "Intrinsic of \"") && line.find("\" / ") != std::string::npos;
}

}  // namespace detail

calibration read_realsense_calibration(std::string const& path, int width, int height,
                                       camera_kind kind) {
  device const all = read_device(path);
  std::string const pair = has_stream(all, "Fisheye 1") ? "Fisheye" : "Infrared";
  bool const colour = has_stream(all, "Color") &&
                      (kind == camera_kind::rgbd || !has_stream(all, (pair + " 1").c_str()));
  std::string const left = colour ? "Color" : pair + " 1";
  calibration result;
  result.rig.left = camera_of(all, left, width, height, path, result.warnings);
  if (is_pair(kind)) {
    std::string const right = pair + " 2";
    result.rig.right = camera_of(all, right, width, height, path, result.warnings);
    stated_place const* const where = place_of(all, left, right);
    if (where == nullptr) {
      throw error(path + ": Extrinsic from \"" + left + "\" To \"" + right + "\" is missing");
    }
    result.rig.T_left_right = where->T_to_from.inverse();
    check_baseline(result.rig, path, "Translation Vector");
  } else {
    set_one_camera(result.rig, kind);
    result.warnings.push_back(path + ": the calibration of \"" + left + "\" is taken");
  }
  for (char const* imu : {"Gyro", "Accel"}) {
    stated_place const* const where = place_of(all, left, imu);
    if (where != nullptr && !result.has_body_frame) {
      result.rig.T_body_left = where->T_to_from;
      result.has_body_frame = true;
    }
  }
  check_rig(result.rig, path, kind);
  return result;
}

}  // namespace seq
