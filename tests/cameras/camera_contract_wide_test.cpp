// SPDX-License-Identifier: Apache-2.0
// The contract, kept by wide-angle models other than Kannala-Brandt.
#include "ft/cameras/double_sphere.hpp"
#include "ft/cameras/field_of_view.hpp"
#include "ft/cameras/unified.hpp"
#include "tests/camera_contract.hpp"

namespace camera_contract_wide_test {

/// TUM-VI's left camera, and so is the next.
struct double_sphere_lens : camera_contract::description<ft::double_sphere> {
  static constexpr int width = 512;
  static constexpr int height = 512;
  static constexpr bool sees_behind = true;
  static ft::double_sphere<double> parameters() {
    return {158.286, 158.274, 254.961, 256.889, -0.172131, 0.593118};
  }
};

struct extended_unified_lens : camera_contract::description<ft::extended_unified> {
  static constexpr int width = 512;
  static constexpr int height = 512;
  static constexpr bool sees_behind = true;
  static ft::extended_unified<double> parameters() {
    return {191.148, 191.137, 254.961, 256.889, 0.632, 1.046};
  }
};

struct unified_lens : camera_contract::description<ft::unified> {
  static constexpr int width = 640;
  static constexpr int height = 480;
  static constexpr bool sees_behind = true;
  static ft::unified<double> parameters() {
    return {430.2, 429.8, 321.3, 238.9, 1.2, {-0.03, 0.01, 0.0004, -0.0003}};
  }
};

struct field_of_view_lens : camera_contract::description<ft::field_of_view> {
  static constexpr int width = 640;
  static constexpr int height = 512;
  static ft::field_of_view<double> parameters() { return {223.6, 223.4, 316.1, 255.9, 0.9335}; }
};

}  // namespace camera_contract_wide_test

FT_CAMERA_CONTRACT(double_sphere, camera_contract_wide_test::double_sphere_lens);
FT_CAMERA_CONTRACT(extended_unified, camera_contract_wide_test::extended_unified_lens);
FT_CAMERA_CONTRACT(unified, camera_contract_wide_test::unified_lens);
FT_CAMERA_CONTRACT(field_of_view, camera_contract_wide_test::field_of_view_lens);
