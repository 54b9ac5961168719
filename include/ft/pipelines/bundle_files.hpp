// SPDX-License-Identifier: Apache-2.0
/// @file Bundles in the text format of "Bundle adjustment in the large" (Agarwal and others, 2010):
/// numbers of views, points and observations; an observation a line, view, point and pixel; nine
/// numbers a view, rotation vector, translation, focal length f, k1, k2; three a point.
///
/// Views look along -z there, with y up, so signs of y and z change here, those of v in pixels,
/// too.
#pragma once

#include <charconv>
#include <cmath>
#include <cstddef>
#include <cstdint>
#include <fstream>
#include <istream>
#include <locale>
#include <ostream>
#include <sstream>
#include <string>
#include <system_error>

#include "ft/cameras/radtan.hpp"
#include "ft/containers/bundle.hpp"
#include "ft/core/config.hpp"
#include "ft/core/error.hpp"
#include "ft/math/quaternion.hpp"
#include "ft/math/small_matrices.hpp"
#include "ft/math/so3.hpp"
#include "ft/types/errors.hpp"
#include "ft/types/poses.hpp"

namespace ft {
inline namespace FT_ABI {

namespace detail {

/// Reads words of the format.
class bal_reader {
public:
  explicit bal_reader(std::istream& in) : in_(in) {}

  bundle<radtan4<double>> read() {
    bundle<radtan4<double>> map;
    int const views = whole("the number of views", most);
    int const points = whole("the number of points", most);
    int const observations = whole("the number of observations", most);
    for (int i = 0; i < observations; ++i) {
      at_ = "observation " + std::to_string(i);
      map.observing_view.push_back(whole("the view", views - 1));
      map.observed_point.push_back(whole("the point", points - 1));
      double const u = number("the pixel");
      map.pixel.push_back({u, -number("the pixel")});
    }
    for (int i = 0; i < views; ++i) {
      at_ = "view " + std::to_string(i);
      read_view(map);
      map.camera_of_view.push_back(i);
    }
    for (int i = 0; i < points; ++i) {
      at_ = "point " + std::to_string(i);
      double const x = number("x");
      double const y = number("y");
      map.position.push_back({x, y, number("z")});
    }
    at_ = "the end";
    std::string rest;
    if (in_ >> rest) { refuse("there is '" + rest + "' after the last number"); }
    if (in_.bad()) { throw error("ft: bundle: cannot be read"); }
    return map;
  }

private:
  static constexpr int most = 1 << 28;

  [[noreturn]] void refuse(std::string const& what) const {
    throw error("ft: bundle, " + at_ + ": " + what);
  }
  std::string word(char const* name) {
    std::string text;
    if (!(in_ >> text)) {
      if (in_.bad()) { throw error("ft: bundle: cannot be read"); }
      refuse(std::string(name) + " is missing");
    }
    return text;
  }
  int whole(char const* name, int last) {
    std::string const text = word(name);
    int value = -1;
    char const* const end = text.data() + text.size();
    auto const result = std::from_chars(text.data(), end, value);
    if (result.ec != std::errc() || result.ptr != end || value < 0 || value > last) {
      refuse(std::string(name) + " is '" + text + "', not a whole number from 0 to " +
             std::to_string(last));
    }
    return value;
  }
  double number(char const* name) {
    std::string const text = word(name);
    double value = 0;
    std::istringstream digits(text);
    digits.imbue(std::locale::classic());
    if (!(digits >> value) || !digits.eof() || !std::isfinite(value)) {
      refuse(std::string(name) + " is '" + text + "', not a finite number");
    }
    return value;
  }
  void read_view(bundle<radtan4<double>>& map) {
    double v[9];
    for (double& n : v) { n = number("a number of the view"); }
    double const turn = std::sqrt(v[0] * v[0] + v[1] * v[1] + v[2] * v[2]);
    if (!(turn < 1e6)) { refuse("the rotation's vector is longer than 1e6 rad"); }
    auto const R = rotation_exp(strict_vec3d{v[0], v[1], v[2]}).cast<double>();
    auto const& m = R.m;
    map.T_cw.push_back(rigid<double>{
        {{m[0], m[1], m[2], -m[3], -m[4], -m[5], -m[6], -m[7], -m[8]}},
        {v[3], -v[4],
         -v[5]}}.orthonormalized());
    radtan4<double> const camera{v[6], v[6], 0, 0, {v[7], v[8], 0, 0}};
    try {
      camera.check();
    } catch (bad_argument const& e) { refuse(e.what()); }
    map.cameras.push_back(camera);
  }

  std::istream& in_;
  std::string at_ = "the first line";
};

/// The nine numbers of a view.
inline void write_view(std::ostream& out, rigid<double> const& T, radtan4<double> const& camera) {
  auto const& m = T.R.m;
  strict_mat3d const R =
      mat3<double>{{m[0], m[1], m[2], -m[3], -m[4], -m[5], -m[6], -m[7], -m[8]}}.cast<real64>();
  vec3<double> const w = log_so3(quaternion_of(R)).cast<double>();
  for (double const v : {w.x, w.y, w.z, T.t.x, -T.t.y, -T.t.z, camera.fx, camera.distortion[0],
                         camera.distortion[1]}) {
    out << number_text(v) << '\n';
  }
}

}  // namespace detail

/// Reads a bundle, each view with a camera of its own. @throws error naming what is wrong
inline bundle<radtan4<double>> read_bal(std::istream& in) { return detail::bal_reader(in).read(); }
/// @throws error, also if the file cannot be opened
inline bundle<radtan4<double>> read_bal(std::string const& path) {
  std::ifstream in(path);
  if (!in) { throw error("ft: bundle: cannot open '" + path + "'"); }
  try {
    return read_bal(in);
  } catch (error const& e) { throw error(std::string(e.what()) + " ('" + path + "')"); }
}

namespace detail {

/// @throws bad_argument for what BAL's format cannot hold
inline void check_bal(bundle<radtan4<double>> const& map) {
  check(map);
  require(map.right_x.empty(), "BAL's format has no right images");
  for (std::size_t i = 0; i < map.cameras.size(); ++i) {
    check_named("camera", i, [&] {
      radtan4<double> const& c = map.cameras[i];
      require(
          c.fx == c.fy && c.cx == 0 && c.cy == 0 && c.distortion[2] == 0 && c.distortion[3] == 0,
          "the camera has more parameters than f, k1 and k2");
    });
  }
}

}  // namespace detail

/// Writes a bundle, numbers with as many digits as they have. Fixed views and standard deviations
/// have no place in the format.
/// @throws bad_argument for an invalid bundle, one with right_x, and for a camera with two focal
/// lengths, a principal
///   point other than 0, or tangential distortion; error if it cannot be written
inline void write_bal(std::ostream& out, bundle<radtan4<double>> const& map) {
  detail::check_bal(map);
  out.imbue(std::locale::classic());
  out << map.T_cw.size() << ' ' << map.position.size() << ' ' << map.pixel.size() << '\n';
  for (std::size_t o = 0; o < map.pixel.size(); ++o) {
    out << map.observing_view[o] << ' ' << map.observed_point[o] << ' '
        << detail::number_text(map.pixel[o].x) << ' ' << detail::number_text(-map.pixel[o].y)
        << '\n';
  }
  for (std::size_t v = 0; v < map.T_cw.size(); ++v) {
    int const camera = map.camera_of_view.empty() ? 0 : map.camera_of_view[v];
    detail::write_view(out, map.T_cw[v], map.cameras[static_cast<std::size_t>(camera)]);
  }
  for (vec3<double> const& X : map.position) {
    for (double const v : {X.x, X.y, X.z}) { out << detail::number_text(v) << '\n'; }
  }
  if (!out.flush()) { throw error("ft: bundle: cannot be written"); }
}
inline void write_bal(std::string const& path, bundle<radtan4<double>> const& map) {
  detail::check_bal(map);  // before a file that is there is emptied
  std::ofstream out(path);
  if (!out) { throw error("ft: bundle: cannot open '" + path + "'"); }
  try {
    write_bal(out, map);
  } catch (error const& e) { throw error(std::string(e.what()) + " ('" + path + "')"); }
}

}  // namespace FT_ABI
}  // namespace ft
