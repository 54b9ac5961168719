// SPDX-License-Identifier: Apache-2.0
/// @file The map of an odometry for other programs: its points as PLY, its keyframes as a TUM
/// trajectory.
#pragma once

#include <cmath>
#include <cstddef>
#include <cstdint>
#include <cstring>
#include <iomanip>
#include <ios>
#include <locale>
#include <ostream>
#include <sstream>
#include <string>

#include "ft/core/config.hpp"
#include "ft/core/error.hpp"
#include "ft/math/quaternion.hpp"
#include "ft/types/poses.hpp"
#include "ft/types/tracking.hpp"

namespace ft {
inline namespace FT_ABI {

struct ply_options {
  bool binary = true;   ///< little-endian; false = text, which keeps all bits, too
  bool normals = true;  ///< mean viewing directions, unit length
  std::uint8_t const* colours = nullptr;  ///< [points][3] red, green, blue; may be null
};

namespace detail {

/// Text with a point as decimal separator, whatever the program's locale.
inline std::ostringstream plain_text() {
  std::ostringstream text;
  text.imbue(std::locale::classic());
  return text;
}

inline void write_all(std::ostream& to, std::string const& bytes) {
  to.write(bytes.data(), static_cast<std::streamsize>(bytes.size()));
  if (!to) { throw error("ft: the map cannot be written to this stream"); }
}

inline void append_little_endian(std::string& bytes, float value) {
  std::uint32_t bits = 0;
  std::memcpy(&bits, &value, sizeof bits);
  for (int shift = 0; shift < 32; shift += 8) {
    bytes += static_cast<char>(static_cast<unsigned char>(bits >> shift));
  }
}

}  // namespace detail

/// Writes the points of a map as PLY 1.0: per vertex float x y z, with normals float nx ny nz, with
/// colours uchar red green blue. World frame, metres, in the order of map.points.
/// @param to opened as binary for a binary file
/// @throws error if the stream fails
inline void write_ply(std::ostream& to, odometry_map const& map, ply_options const& options = {}) {
  auto head = detail::plain_text();
  head << "ply\nformat " << (options.binary ? "binary_little_endian" : "ascii")
       << " 1.0\ncomment map points of ft, metres\nelement vertex " << map.points.size() << '\n';
  head << "property float x\nproperty float y\nproperty float z\n";
  if (options.normals) { head << "property float nx\nproperty float ny\nproperty float nz\n"; }
  if (options.colours != nullptr) {
    head << "property uchar red\nproperty uchar green\nproperty uchar blue\n";
  }
  head << "end_header\n";
  detail::write_all(to, head.str());
  std::string bytes;
  auto text = detail::plain_text();
  text << std::setprecision(9);  // as many digits as tell floats apart
  std::uint8_t const* colour = options.colours;
  for (downloaded_point const& p : map.points) {
    float const values[6] = {p.position.x, p.position.y, p.position.z,
                             p.normal.x,   p.normal.y,   p.normal.z};
    for (int i = 0; i < (options.normals ? 6 : 3); ++i) {
      if (options.binary) {
        detail::append_little_endian(bytes, values[i]);
      } else {
        text << (i > 0 ? " " : "") << values[i];
      }
    }
    for (int i = 0; colour != nullptr && i < 3; ++i, ++colour) {
      if (options.binary) {
        bytes += static_cast<char>(*colour);
      } else {
        text << ' ' << static_cast<int>(*colour);
      }
    }
    if (!options.binary) { text << '\n'; }
  }
  detail::write_all(to, options.binary ? bytes : text.str());
}

/// Writes the keyframes of a map as a trajectory in the format of the TUM RGB-D benchmark: a line
/// "time tx ty tz qx qy qz qw" each, oldest first, seconds and metres, T_world_camera. Source: J.
/// Sturm and others, "A benchmark for the evaluation of RGB-D SLAM systems", 2012.
/// @throws error if the stream fails
inline void write_tum(std::ostream& to, odometry_map const& map) {
  auto text = detail::plain_text();
  text << "# time tx ty tz qx qy qz qw (seconds, metres; keyframes, camera to world)\n"
       << std::fixed << std::setfill('0');
  for (downloaded_keyframe const& k : map.keyframes) {
    constexpr std::uint64_t second = 1'000'000'000;
    bool const negative = k.time_ns < 0;
    auto const stamp = static_cast<std::uint64_t>(k.time_ns);
    std::uint64_t const ns = negative ? 0 - stamp : stamp;
    text << (negative ? "-" : "") << ns / second << '.' << std::setw(9) << ns % second;
    vec3<double> const& t = k.T_world_camera.t;
    quaternion<double> const q = detail::quaternion_of(k.T_world_camera.R);
    double const values[7] = {t.x, t.y, t.z, q.x, q.y, q.z, q.w};
    for (double const value : values) { text << ' ' << std::setprecision(9) << value; }
    text << '\n';
  }
  detail::write_all(to, text.str());
}

}  // namespace FT_ABI
}  // namespace ft
