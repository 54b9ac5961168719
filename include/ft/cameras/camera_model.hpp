// SPDX-License-Identifier: Apache-2.0
/// @file The contract of a camera model, and the traits that check it.
///
/// A model is a plain struct templated on its scalar (float, double or ft::strict of either):
///
///     template <typename Scalar>
///     struct my_camera {
///       using scalar_type = Scalar;
///       static constexpr char const* name = "my_camera";
///       static constexpr auto parameters = ft::camera_parameters({{"k", -1, 1}});
///       Scalar fx, fy, cx, cy, k;
///
///       FT_HOST_DEVICE ft::projection<Scalar> project(ft::vec3<Scalar> p) const;
///       FT_HOST_DEVICE ft::projection_with_jacobian<Scalar> project_with_jacobian(
///           ft::vec3<Scalar> p) const;
///       FT_HOST_DEVICE ft::ray<Scalar> unproject(ft::vec2<Scalar> pixel) const;
///       template <typename U>
///       FT_HOST_DEVICE my_camera<U> cast() const {
///         return ft::cast_camera<my_camera<U>>(*this);
///       }
///       void check() const { ft::check_camera(*this); }
///     };
///
/// Its data members are the parameters, in the order of `parameters`, and nothing else. All member
/// functions except check() are FT_HOST_DEVICE. There are no virtual functions, and the struct is
/// trivially copyable. The camera frame has x right, y down, z forward.
#pragma once

#include <cstddef>
#include <cstring>
#include <limits>
#include <string>
#include <type_traits>
#include <utility>

#include "ft/core/arithmetic.hpp"
#include "ft/core/config.hpp"
#include "ft/core/error.hpp"
#include "ft/types/poses.hpp"

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

/// A projection and its derivative, for solvers. `value` agrees with project() up to rounding.
template <typename Scalar>
struct projection_with_jacobian {
  projection<Scalar> value;
  mat23<Scalar> jacobian;  ///< d pixel / d point
};

// ---- parameters

/// A parameter of a camera model and its limits, inclusive. By default, any finite value.
struct camera_parameter {
  char const* name = "";
  double low = -std::numeric_limits<double>::infinity();
  double high = std::numeric_limits<double>::infinity();
};

/// The parameters of a model, in the order of its data members.
template <int Count>
struct camera_parameter_list {
  static constexpr int count = Count;
  camera_parameter of[Count];
};

/// A list of fx and fy, in [1e-3, 1e6] pixels, cx and cy.
constexpr camera_parameter_list<4> camera_parameters() {
  return {{{"fx", 1e-3, 1e6}, {"fy", 1e-3, 1e6}, {"cx"}, {"cy"}}};
}
/// A list of fx, fy, cx and cy, followed by the parameters given.
template <int More>
constexpr camera_parameter_list<4 + More> camera_parameters(camera_parameter const (&more)[More]) {
  camera_parameter_list<4 + More> all{};
  for (int i = 0; i < 4; ++i) { all.of[i] = camera_parameters().of[i]; }
  for (int i = 0; i < More; ++i) { all.of[4 + i] = more[i]; }
  return all;
}

/// Number of parameters of a camera model.
template <typename Camera>
inline constexpr int num_params_v = std::decay_t<decltype(Camera::parameters)>::count;

/// A camera with the parameters of `from` in another scalar. For cast() of a model.
template <typename To, typename From>
FT_HOST_DEVICE To cast_camera(From const& from) {
  using scalar_to = typename To::scalar_type;
  typename From::scalar_type before[num_params_v<From>];
  scalar_to after[num_params_v<From>];
  static_assert(sizeof(From) == sizeof before && sizeof(To) == sizeof after,
                "a camera model holds its parameters and nothing else");
  std::memcpy(before, &from, sizeof before);
  FT_UNROLL
  for (int i = 0; i < num_params_v<From>; ++i) {
    after[i] = scalar_to(static_cast<plain_scalar_t<scalar_to>>(to_plain(before[i])));
  }
  To to;
  std::memcpy(&to, after, sizeof after);
  return to;
}

/// Checks the parameters of a model against their limits. For check() of a model; host only.
/// @throws bad_argument naming the first parameter that is not finite or outside its limits
template <typename Camera>
void check_camera(Camera const& camera) {
  auto const numbers = camera.template cast<double>();
  double values[num_params_v<Camera>];
  std::memcpy(values, &numbers, sizeof values);
  for (int i = 0; i < num_params_v<Camera>; ++i) {
    camera_parameter const& p = Camera::parameters.of[i];
    std::string const name = std::string("camera ") + p.name;
    detail::require_finite(name.c_str(), values[i]);
    detail::require_range(name.c_str(), values[i], p.low, p.high);
  }
}

// ---- the contract

namespace detail {

template <typename C>
using camera_project =
    decltype(std::declval<C const&>().project(std::declval<vec3<typename C::scalar_type>>()));
template <typename C>
using camera_project_with_jacobian = decltype(std::declval<C const&>().project_with_jacobian(
    std::declval<vec3<typename C::scalar_type>>()));
template <typename C>
using camera_unproject =
    decltype(std::declval<C const&>().unproject(std::declval<vec2<typename C::scalar_type>>()));
template <typename C>
using camera_cast = decltype(std::declval<C const&>().template cast<double>());
template <typename C>
using camera_check = decltype(std::declval<C const&>().check());
template <typename C>
using camera_names = decltype(C::parameters.of[0].name, C::name);
template <typename C>
using camera_scalar = typename C::scalar_type;

template <template <typename> class Expression, typename C, typename = void>
inline constexpr bool is_expression = false;
template <template <typename> class Expression, typename C>
inline constexpr bool is_expression<Expression, C, std::void_t<Expression<C>>> = true;

/// Whether an expression of a camera has the type Result<scalar_type>.
template <template <typename> class Expression, template <typename> class Result, typename C,
          typename = void>
inline constexpr bool gives = false;
template <template <typename> class Expression, template <typename> class Result, typename C>
inline constexpr bool gives<Expression, Result, C, std::void_t<Expression<C>>> =
    std::is_same<Expression<C>, Result<typename C::scalar_type>>::value;

/// Whether the data members of a camera are its parameters and nothing else.
template <typename C, typename = void>
inline constexpr bool holds_its_parameters = false;
template <typename C>
inline constexpr bool holds_its_parameters<C, std::void_t<camera_names<C>, camera_scalar<C>>> =
    std::is_trivially_copyable<C>::value &&
    sizeof(C) == static_cast<std::size_t>(num_params_v<C>) * sizeof(typename C::scalar_type);

}  // namespace detail

/// Whether a type satisfies the contract above.
template <typename C>
inline constexpr bool is_camera_model_v =
    detail::holds_its_parameters<C>&& detail::gives<detail::camera_project, projection, C>&&
        detail::gives<detail::camera_project_with_jacobian, projection_with_jacobian, C>&&
            detail::gives<detail::camera_unproject, ray, C>&& detail::is_expression<
                detail::camera_cast, C>&& detail::is_expression<detail::camera_check, C>;

/// Instantiating it makes the compiler name the part of the contract that a type misses.
template <typename C>
struct assert_camera_model {
  static constexpr bool has_scalar = detail::is_expression<detail::camera_scalar, C>;
  static_assert(has_scalar, "a camera model needs: using scalar_type = Scalar");
  static_assert(detail::is_expression<detail::camera_names, C>,
                "a camera model needs: name, and parameters = ft::camera_parameters(...)");
  static_assert(!has_scalar || !detail::is_expression<detail::camera_names, C> ||
                    detail::holds_its_parameters<C>,
                "a camera model holds its parameters and nothing else");
  static_assert(!has_scalar || detail::gives<detail::camera_project, projection, C>,
                "a camera model needs: ft::projection<Scalar> project(ft::vec3<Scalar>) const");
  static_assert(
      !has_scalar ||
          detail::gives<detail::camera_project_with_jacobian, projection_with_jacobian, C>,
      "a camera model needs: "
      "ft::projection_with_jacobian<Scalar> project_with_jacobian(ft::vec3<Scalar>) const");
  static_assert(!has_scalar || detail::gives<detail::camera_unproject, ray, C>,
                "a camera model needs: ft::ray<Scalar> unproject(ft::vec2<Scalar>) const");
  static_assert(detail::is_expression<detail::camera_cast, C>,
                "a camera model needs: template <typename U> my_camera<U> cast() const");
  static_assert(detail::is_expression<detail::camera_check, C>,
                "a camera model needs: void check() const");
  /// Always true: if the contract is not met, the assertions above are the error.
  static constexpr bool value = true;
};

namespace detail {

/// The ray of a pixel of `from`, rotated by `R_to_from` and projected by `to`. Valid where both
/// models are defined and the result is finite. With cameras of strict_double all executors give
/// the same bits, except for the last bit of an arc tangent or tangent in a camera model.
template <typename From, typename To>
FT_HOST_DEVICE projection<strict_double> transfer_pixel(From const& from,
                                                        mat3<strict_double> const& R_to_from,
                                                        To const& to, vec2<strict_double> pixel) {
  auto const seen = from.unproject(pixel);
  auto const projected = to.project(R_to_from * seen.direction);
  bool const finite = scalar::is_finite(projected.pixel.x) && scalar::is_finite(projected.pixel.y);
  return {projected.pixel, seen.valid && projected.valid && finite};
}

inline mat3<strict_double> strict_rotation(mat3<double> const& R) {
  mat3<strict_double> strict;
  for (int i = 0; i < 9; ++i) { strict.m[i] = R.m[i]; }
  return strict;
}

// Shared by the camera models: the intrinsics fx, fy, cx and cy, and results outside the
// domain.

/// A pixel in the image plane z = 1 of an ideal pinhole.
template <typename Camera, typename Scalar>
FT_HOST_DEVICE vec2<Scalar> normalized(Camera const& c, vec2<Scalar> pixel) {
  return {(pixel.x - c.cx) / c.fx, (pixel.y - c.cy) / c.fy};
}

/// The principal point, invalid.
template <typename Camera>
FT_HOST_DEVICE projection<typename Camera::scalar_type> no_pixel(Camera const& c) {
  return {{c.cx, c.cy}, false};
}

/// The pixel (u, v); the principal point, invalid, if it is not finite.
template <typename Camera, typename Scalar>
FT_HOST_DEVICE projection<Scalar> finite_pixel(Camera const& c, Scalar u, Scalar v) {
  if (!scalar::is_finite(u) || !scalar::is_finite(v)) { return no_pixel(c); }
  return {{u, v}, true};
}

/// The optical axis, invalid.
template <typename Scalar>
FT_HOST_DEVICE ray<Scalar> no_ray() {
  return {{Scalar(0), Scalar(0), Scalar(1)}, false};
}

/// The ray of length 1 along d; the axis, invalid, if d has no direction.
template <typename Scalar>
FT_HOST_DEVICE ray<Scalar> unit_ray(vec3<Scalar> d, Scalar norm) {
  if (!(norm > Scalar(0)) || !scalar::is_finite(norm)) { return no_ray<Scalar>(); }
  return {{d.x / norm, d.y / norm, d.z / norm}, true};
}

}  // namespace detail

}  // namespace FT_ABI
}  // namespace ft
