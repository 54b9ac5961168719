// SPDX-License-Identifier: Apache-2.0
/// @file The contract of a camera model, and a trait that checks it.
///
/// A model is a plain struct templated on its scalar (float, double or ft::strict of either):
///
///     template <typename Scalar> struct my_camera {
///       using scalar_type = Scalar;
///       static constexpr int num_params = ...;
///       static constexpr char const* name = "...";
///       Scalar ...;  // the parameters, in order
///
///       projection<Scalar> project(vec3<Scalar> p) const;      // camera frame -> pixel
///       ray<Scalar> unproject(vec2<Scalar> pixel) const;       // pixel -> direction
///       mat23<Scalar> project_jacobian(vec3<Scalar> p) const;  // d pixel / d point
///       template <typename U> my_camera<U> cast() const;
///       void check() const;  // host; throws bad_argument
///     };
///
/// All members except check() are FT_HOST_DEVICE. There are no virtual functions, and the struct is
/// trivially copyable. The camera frame has x right, y down, z forward.
#pragma once

#include <type_traits>
#include <utility>

#include "ft/core/config.hpp"
#include "ft/core/error.hpp"
#include "ft/core/geometry.hpp"

namespace ft {
inline namespace FT_ABI {

/// A pixel, and whether the point lies in the domain of the model.
template <typename Scalar>
struct projection {
  vec2<Scalar> pixel;
  bool valid;
};

/// A direction in the camera frame, of any length, and whether the pixel lies in the domain.
template <typename Scalar>
struct ray {
  vec3<Scalar> direction;
  bool valid;
};

/// 2 x 3, row-major.
template <typename Scalar>
struct mat23 {
  Scalar m[6];
};

namespace detail {

template <typename C, typename = void>
struct has_project : std::false_type {};
template <typename C>
struct has_project<C, std::void_t<decltype(std::declval<C const&>().project(
                          std::declval<vec3<typename C::scalar_type>>()))>>
    : std::is_same<decltype(std::declval<C const&>().project(
                       std::declval<vec3<typename C::scalar_type>>())),
                   projection<typename C::scalar_type>> {};

template <typename C, typename = void>
struct has_unproject : std::false_type {};
template <typename C>
struct has_unproject<C, std::void_t<decltype(std::declval<C const&>().unproject(
                            std::declval<vec2<typename C::scalar_type>>()))>>
    : std::is_same<decltype(std::declval<C const&>().unproject(
                       std::declval<vec2<typename C::scalar_type>>())),
                   ray<typename C::scalar_type>> {};

template <typename C, typename = void>
struct has_jacobian : std::false_type {};
template <typename C>
struct has_jacobian<C, std::void_t<decltype(std::declval<C const&>().project_jacobian(
                           std::declval<vec3<typename C::scalar_type>>()))>>
    : std::is_same<decltype(std::declval<C const&>().project_jacobian(
                       std::declval<vec3<typename C::scalar_type>>())),
                   mat23<typename C::scalar_type>> {};

template <typename C, typename = void>
struct has_joint_projection : std::false_type {};
template <typename C>
struct has_joint_projection<C, std::void_t<decltype(std::declval<C const&>().project_with_jacobian(
                                   std::declval<vec3<typename C::scalar_type>>(),
                                   std::declval<mat23<typename C::scalar_type>&>()))>>
    : std::true_type {};

template <typename C, typename = void>
struct has_names : std::false_type {};
template <typename C>
struct has_names<C, std::void_t<decltype(C::num_params), decltype(C::name)>> : std::true_type {};

template <typename C, typename = void>
struct has_cast : std::false_type {};
template <typename C>
struct has_cast<C, std::void_t<decltype(std::declval<C const&>().template cast<double>())>>
    : std::true_type {};

template <typename C, typename = void>
struct has_check : std::false_type {};
template <typename C>
struct has_check<C, std::void_t<decltype(std::declval<C const&>().check())>> : std::true_type {};

}  // namespace detail

/// A projection and its derivative. A model whose project() and project_jacobian() share much work
/// may have a member
/// `projection<Scalar> project_with_jacobian(vec3<Scalar> p, mat23<Scalar>& jacobian) const`.
/// Its values need to agree up to rounding only: it is for solvers.
template <typename C, typename Scalar>
FT_HOST_DEVICE projection<Scalar> project_and_differentiate(C const& camera, vec3<Scalar> p,
                                                            mat23<Scalar>& jacobian) {
  if constexpr (detail::has_joint_projection<C>::value) {
    return camera.project_with_jacobian(p, jacobian);
  } else {
    jacobian = camera.project_jacobian(p);
    return camera.project(p);
  }
}

/// True for a type that satisfies the contract above.
template <typename C>
inline constexpr bool is_camera_model_v =
    std::is_trivially_copyable<C>::value&& detail::has_project<C>::value&&
        detail::has_unproject<C>::value&& detail::has_jacobian<C>::value&&
            detail::has_names<C>::value&& detail::has_cast<C>::value&& detail::has_check<C>::value;

/// Instantiate it to see which part of the contract a type violates.
template <typename C>
struct assert_camera_model {
  static_assert(std::is_trivially_copyable<C>::value,
                "a camera model is passed to kernels by value");
  static_assert(detail::has_project<C>::value,
                "a camera model needs: projection<Scalar> project(vec3<Scalar>) const");
  static_assert(detail::has_unproject<C>::value,
                "a camera model needs: ray<Scalar> unproject(vec2<Scalar>) const");
  static_assert(detail::has_jacobian<C>::value,
                "a camera model needs: mat23<Scalar> project_jacobian(vec3<Scalar>) const");
  static_assert(detail::has_names<C>::value, "a camera model needs: num_params and name");
  static_assert(detail::has_cast<C>::value,
                "a camera model needs: template <typename U> my_camera<U> cast() const");
  static_assert(detail::has_check<C>::value, "a camera model needs: void check() const");
  static constexpr bool value = is_camera_model_v<C>;
};

/// Checks intrinsics in pixels, for check() of a model. Host only.
/// @throws bad_argument if a value is not finite, or a focal length is not in [1e-3, 1e6]
template <typename Scalar>
void check_intrinsics(Scalar fx, Scalar fy, Scalar cx, Scalar cy) {
  auto const plain = [](Scalar value) { return static_cast<double>(to_plain(value)); };
  detail::require_finite("camera fx", plain(fx));
  detail::require_finite("camera fy", plain(fy));
  detail::require_finite("camera cx", plain(cx));
  detail::require_finite("camera cy", plain(cy));
  detail::require_range("camera fx", plain(fx), 1e-3, 1e6);
  detail::require_range("camera fy", plain(fy), 1e-3, 1e6);
}

}  // namespace FT_ABI
}  // namespace ft
