// SPDX-License-Identifier: Apache-2.0
/// @file Rigs of cameras of several models in the rendered room of room.hpp.
#pragma once

#include <cstddef>
#include <vector>

#include "ft/cameras/any_camera.hpp"
#include "ft/cameras/mixed_rig.hpp"
#include "ft/types/images.hpp"
#include "ft/types/poses.hpp"
#include "tests/support/multi_rig_walk.hpp"
#include "tests/support/room.hpp"

namespace test {
namespace rigs {

using any = ft::any_camera<float>;

/// Images of a mixed rig at a pose of its body. What there is not is empty.
struct mixed_frame {
  std::vector<image> images;               ///< as mixed_images
  std::vector<std::vector<float>> depths;  ///< metres
  ft::pose T_cw;                           ///< true, of the body
};

/// Depths along the camera's axis, metres.
inline std::vector<float> render_depth(any const& camera, ft::pose const& T_cw) {
  auto const T_wc = T_cw.inverse();
  std::vector<float> depths;
  for (int v = 0; v < room::height; ++v) {
    for (int u = 0; u < room::width; ++u) {
      auto const p = room::look(camera, T_wc, static_cast<float>(u), static_cast<float>(v)).point;
      depths.push_back(static_cast<float>((T_cw.cast<double>() * p).z));
    }
  }
  return depths;
}

/// What a rig sees whose body is at T_bw.
template <int N>
mixed_frame see_mixed(ft::mixed_rig<N> const& rig, std::vector<image> const& walls,
                      ft::pose const& T_bw) {
  mixed_frame f{{}, {}, T_bw};
  for (ft::mixed_rig_camera const& c : rig.of) {
    ft::pose const T_cw = c.T_cb * f.T_cw;
    f.images.push_back(c.used ? room::render(c.camera, walls, T_cw) : image{});
    ft::pose T_rw = T_cw;
    T_rw.t.x -= static_cast<float>(c.baseline);
    f.images.push_back(c.has_right_image ? room::render(c.camera, walls, T_rw) : image{});
    f.depths.push_back(c.has_depth_image ? render_depth(c.camera, T_cw) : std::vector<float>{});
  }
  return f;
}

template <int N>
std::vector<mixed_frame> make_mixed_walk(ft::mixed_rig<N> const& rig, unsigned seed, int frames) {
  auto const walls = room::make_walls(seed);
  std::vector<mixed_frame> walk;
  for (int i = 0; i < frames; ++i) {
    auto const step = static_cast<float>(i);
    walk.push_back(
        see_mixed(rig, walls, turned(0.012f * step, {0.02f * step, -0.01f * step, 0.05f * step})));
  }
  return walk;
}

template <int N>
ft::mixed_images<N> views_of(mixed_frame const& f) {
  ft::mixed_images<N> views;
  for (int i = 0; i < 2 * N; ++i) { views.of[i] = room::view(f.images[at(i)]); }
  for (int c = 0; c < N; ++c) {
    views.depth[c] =
        ft::image_view<float const>{f.depths[at(c)].data(), room::width, room::height, room::width};
  }
  return views;
}

}  // namespace rigs
}  // namespace test
