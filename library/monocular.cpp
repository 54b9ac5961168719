// SPDX-License-Identifier: Apache-2.0
#include "library/made.hpp"
#include "library/rigs.hpp"

namespace ft::library::FT_LIBRARY_DEVICE {

FT_LIBRARY_FACTORY any_odometry make_monocular(odometry_request const& of) {
  rig_description const& rig = of.rig;
  auto const with = [&](auto const& camera) {
    auto one = monocular_rig<std::decay_t<decltype(camera)>>::make(camera);
    one.readout_s = narrow(rig.camera[0].readout_s);
    one.check();
    return made(of, one);
  };
  if (rig.camera[0].kind == camera_kind::pinhole) { return with(pinhole_of(rig, 0)); }
  return with(camera_of<kannala_brandt<float>>(rig, 0, camera_kind::kannala_brandt,
                                               "monocular of pinhole or kannala_brandt"));
}

}  // namespace ft::library::FT_LIBRARY_DEVICE
