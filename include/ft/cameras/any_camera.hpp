// SPDX-License-Identifier: Apache-2.0
/// @file A camera of one of several models, chosen at run time.
#pragma once

#include <cstddef>
#include <cstring>
#include <string>

#include "ft/cameras/camera_model.hpp"
#include "ft/cameras/double_sphere.hpp"
#include "ft/cameras/kannala_brandt.hpp"
#include "ft/cameras/pinhole.hpp"
#include "ft/cameras/radtan.hpp"
#include "ft/core/arithmetic.hpp"
#include "ft/core/config.hpp"
#include "ft/core/error.hpp"
#include "ft/types/poses.hpp"
#include "ft/types/rig_description.hpp"

namespace ft {
inline namespace FT_ABI {

/// A pinhole, radtan8 (so also radtan4 and radtan5), kannala_brandt or double_sphere camera. Each
/// function returns what that model's returns, to the bit.
///
/// Threads that work on cameras of different models at the same time wait for each other: rigs in
/// which a warp has one camera are as fast as with the model itself, but for the choice.
template <typename Scalar>
struct any_camera {
  using scalar_type = Scalar;
  static constexpr char const* name = "any_camera";
  static constexpr auto parameters = camera_parameters({{"parameter 5"},
                                                        {"parameter 6"},
                                                        {"parameter 7"},
                                                        {"parameter 8"},
                                                        {"parameter 9"},
                                                        {"parameter 10"},
                                                        {"parameter 11"},
                                                        {"parameter 12"},
                                                        {"kind", 0, 8}});
  Scalar fx, fy, cx, cy;
  Scalar more[8];  ///< of the model, in its own order; the rest is 0
  Scalar kind;     ///< camera_kind as a number

  /// @throws bad_argument for a model that is none of these
  template <template <typename> class Model>
  static any_camera of(Model<Scalar> const& camera) {
    return of_kind(kind_of(camera), camera);
  }
  template <int Coefficients>
  static any_camera of(radtan<Scalar, Coefficients> const& camera) {
    return of_kind(camera_kind::radtan8, camera);
  }

  /// @throws bad_argument for a kind that is none of these, or what the model's check() throws for
  void check() const {
    check_camera(*this);
    if (is(camera_kind::kannala_brandt)) { return as<kannala_brandt<Scalar>>().check(); }
    if (is(camera_kind::radtan8)) { return as<radtan8<Scalar>>().check(); }
    if (is(camera_kind::double_sphere)) { return as<double_sphere<Scalar>>().check(); }
    detail::require(is(camera_kind::pinhole),
                    "camera kind must be pinhole, radtan8, kannala_brandt or double_sphere");
    as<pinhole<Scalar>>().check();
  }
  FT_HOST_DEVICE bool is(camera_kind k) const { return kind == number(k); }

  FT_HOST_DEVICE projection<Scalar> project(vec3<Scalar> p) const {
    return with([&](auto const& camera) { return camera.project(p); });
  }
  FT_HOST_DEVICE ray<Scalar> unproject(vec2<Scalar> pixel) const {
    return with([&](auto const& camera) { return camera.unproject(pixel); });
  }
  FT_HOST_DEVICE projection_with_jacobian<Scalar> project_with_jacobian(vec3<Scalar> p) const {
    return with([&](auto const& camera) { return camera.project_with_jacobian(p); });
  }
  template <typename U>
  FT_HOST_DEVICE any_camera<U> cast() const {
    return cast_camera<any_camera<U>>(*this);
  }

private:
  FT_HOST_DEVICE static Scalar number(camera_kind k) {
    return Scalar(static_cast<plain_scalar_t<Scalar>>(static_cast<int>(k)));
  }
  static constexpr camera_kind kind_of(pinhole<Scalar> const&) { return camera_kind::pinhole; }
  static constexpr camera_kind kind_of(kannala_brandt<Scalar> const&) {
    return camera_kind::kannala_brandt;
  }
  static constexpr camera_kind kind_of(double_sphere<Scalar> const&) {
    return camera_kind::double_sphere;
  }
  template <typename Model>
  static any_camera of_kind(camera_kind kind, Model const& camera) {
    static_assert(sizeof(Model) <= offsetof(any_camera, kind), "its parameters fit");
    any_camera any{};
    std::memcpy(static_cast<void*>(&any), &camera, sizeof camera);
    any.kind = number(kind);
    return any;
  }
  template <typename Model>
  FT_HOST_DEVICE Model as() const {
    Model camera;
    std::memcpy(&camera, this, sizeof camera);
    return camera;
  }
  /// What `call` returns for the camera as one of its own model.
  template <typename Call>
  FT_HOST_DEVICE auto with(Call const& call) const {
    if (is(camera_kind::kannala_brandt)) { return call(as<kannala_brandt<Scalar>>()); }
    if (is(camera_kind::radtan8)) { return call(as<radtan8<Scalar>>()); }
    if (is(camera_kind::double_sphere)) { return call(as<double_sphere<Scalar>>()); }
    return call(as<pinhole<Scalar>>());
  }
};

static_assert(assert_camera_model<any_camera<float>>::value,
              "any_camera keeps the camera contract");

}  // namespace FT_ABI
}  // namespace ft
