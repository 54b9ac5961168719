// SPDX-License-Identifier: Apache-2.0
/// @file Descriptions of rigs as types of ft.
#pragma once

#include <cstring>
#include <string>

#include "ft/any_odometry.hpp"
#include "ft/cameras/any_camera.hpp"
#include "ft/cameras/camera_model.hpp"
#include "ft/cameras/distorted_pair.hpp"
#include "ft/cameras/double_sphere.hpp"
#include "ft/cameras/kannala_brandt.hpp"
#include "ft/cameras/mixed_rig.hpp"
#include "ft/cameras/monocular_rig.hpp"
#include "ft/cameras/multi_rig.hpp"
#include "ft/cameras/pinhole.hpp"
#include "ft/cameras/radtan.hpp"
#include "ft/cameras/rgbd_rig.hpp"
#include "ft/cameras/stereo_rig.hpp"
#include "library/factories.hpp"

namespace ft::library::FT_LIBRARY_DEVICE {

inline float narrow(double v) { return static_cast<float>(v); }

[[noreturn]] inline void refuse(rig_description const& rig, int camera, char const* there_are) {
  throw bad_argument(std::string("ft: camera ") + std::to_string(camera) + " of the " +
                     name_of(rig.kind) + " rig is " + name_of(rig.camera[camera].kind) +
                     "; ft::odometry was compiled for " + there_are +
                     ". ft::erase() takes an odometry of any camera model");
}

/// Camera c of a rig. @throws bad_argument, with the models there are, for one of another model
template <typename Camera>
Camera camera_of(rig_description const& rig, int c, camera_kind kind, char const* there_are) {
  camera_description const& given = rig.camera[c];
  if (given.kind != kind) { refuse(rig, c, there_are); }
  constexpr int count = num_params_v<Camera>;
  static_assert(sizeof(Camera) == count * sizeof(float), "nothing but its parameters");
  static_assert(count <= most_camera_parameters, "they fit");
  Camera camera{};
  float values[count];
  for (int i = 0; i < count; ++i) { values[i] = narrow(given.parameters[i]); }
  std::memcpy(&camera, values, sizeof camera);
  return camera;
}
inline pinhole<float> pinhole_of(rig_description const& rig, int c) {
  return camera_of<pinhole<float>>(rig, c, camera_kind::pinhole, "pinhole");
}

/// Right camera from the left one. @throws bad_argument if the left one is not the body
inline pose right_from_left(rig_description const& rig) {
  rigid<double> const& T = rig.camera[0].T_camera_body;
  rigid<double> const same = rigid<double>::identity();
  bool is_body = T.t.x == 0 && T.t.y == 0 && T.t.z == 0;
  for (int i = 0; i < 9; ++i) { is_body = is_body && T.R.m[i] == same.R.m[i]; }
  if (!is_body) {
    throw bad_argument(std::string("ft: T_camera_body of the left camera of a ") +
                       name_of(rig.kind) + " must be the identity");
  }
  return rig.camera[1].T_camera_body.cast<float>();
}

inline rectified_rig rectified_pair_of(rig_description const& rig) {
  auto pair = rectified_rig::make(pinhole_of(rig, 0), rig.camera[0].baseline);
  pair.readout_s = narrow(rig.camera[0].readout_s);
  pair.check();
  return pair;
}

inline distorted_pair<radtan8<float>> distorted_pair_of(rig_description const& rig) {
  using camera = radtan8<float>;
  auto const of = [&](int c) {
    return camera_of<camera>(rig, c, camera_kind::radtan8, "distorted pairs of radtan8");
  };
  double const* const k = rig.rectified;
  auto pair = distorted_pair<camera>::make(
      of(0), of(1), right_from_left(rig),
      pinhole<float>{narrow(k[0]), narrow(k[1]), narrow(k[2]), narrow(k[3])});
  pair.width = rig.raw_width;
  pair.height = rig.raw_height;
  pair.readout_s = narrow(rig.camera[0].readout_s);
  pair.check();
  return pair;
}

using fisheye_rig = stereo_rig<kannala_brandt<float>, kannala_brandt<float>>;
inline fisheye_rig fisheye_pair_of(rig_description const& rig) {
  auto const of = [&](int c) {
    return camera_of<kannala_brandt<float>>(rig, c, camera_kind::kannala_brandt,
                                            "fisheye pairs of kannala_brandt");
  };
  return {of(0), of(1), right_from_left(rig), narrow(rig.camera[0].readout_s)};
}

template <typename Camera>
rgbd_rig<Camera> rgbd_of(rig_description const& of, Camera const& camera) {
  auto rig = rgbd_rig<Camera>::make(camera, of.camera[0].baseline, narrow(of.depth_scale));
  rig.min_depth = narrow(of.min_depth);
  rig.max_depth = narrow(of.max_depth);
  rig.readout_s = narrow(of.camera[0].readout_s);
  rig.check();
  return rig;
}

/// @tparam N at least as many cameras as there are; the others are not used
template <int N>
multi_rig<N> multi_of(rig_description const& of) {
  multi_rig<N> rig{};
  for (rig_camera& c : rig.of) { c = rig_camera::none(); }
  for (int i = 0; i < of.cameras; ++i) {
    rig.of[i] = {pinhole_of(of, i), of.camera[i].baseline, of.camera[i].T_camera_body.cast<float>(),
                 true, narrow(of.camera[i].readout_s)};
  }
  return rig;
}

/// Camera c of any model. @throws bad_argument, with the models there are
inline any_camera<float> any_camera_of(rig_description const& rig, int c) {
  constexpr char const* there_are =
      "multi rigs of pinhole, radtan4, radtan5, radtan8, kannala_brandt and double_sphere";
  camera_kind const kind = rig.camera[c].kind;
  auto const with = [&](auto camera) {
    using camera_type = decltype(camera);
    return any_camera<float>::of(camera_of<camera_type>(rig, c, kind, there_are));
  };
  switch (kind) {
    case camera_kind::pinhole:
      return with(pinhole<float>{});
    case camera_kind::radtan4:
      return with(radtan4<float>{});
    case camera_kind::radtan5:
      return with(radtan5<float>{});
    case camera_kind::radtan8:
      return with(radtan8<float>{});
    case camera_kind::kannala_brandt:
      return with(kannala_brandt<float>{});
    case camera_kind::double_sphere:
      return with(double_sphere<float>{});
    default:
      break;
  }
  refuse(rig, c, there_are);
}

/// @tparam N as in multi_of(). @throws bad_argument
template <int N>
mixed_rig<N> mixed_of(rig_description const& of) {
  mixed_rig<N> rig{};
  for (mixed_rig_camera& c : rig.of) { c = mixed_rig_camera::none(); }
  for (int i = 0; i < of.cameras; ++i) {
    camera_description const& given = of.camera[i];
    mixed_rig_camera c =
        mixed_rig_camera::single(any_camera_of(of, i), given.T_camera_body.cast<float>());
    c.baseline = given.right >= 0 ? 0 : given.baseline;
    c.readout_s = narrow(given.readout_s);
    c.has_depth_image = given.has_depth_image;
    c.has_right_image = !given.has_depth_image && given.right < 0 && given.baseline != 0;
    if (c.has_depth_image) {
      c.depth_scale = narrow(of.depth_scale);
      c.min_depth = narrow(of.min_depth);
      c.max_depth = narrow(of.max_depth);
    }
    rig.of[i] = c;
  }
  for (int i = 0; i < of.cameras; ++i) {
    int const right = of.camera[i].right;
    if (right >= of.cameras) {
      throw bad_argument("ft: the right camera of camera " + std::to_string(i) + " is " +
                         std::to_string(right) + ", must be below " + std::to_string(of.cameras));
    }
    if (right >= 0) { pair_up(rig, i, right); }
  }
  return rig;
}

}  // namespace ft::library::FT_LIBRARY_DEVICE
