// SPDX-License-Identifier: Apache-2.0
// The contract, kept by pinholes with distortion.
#include "ft/cameras/radtan.hpp"
#include "tests/camera_contract.hpp"

namespace camera_contract_radtan_test {

/// EuRoC's left camera before rectification.
struct radtan4_lens : camera_contract::description<ft::radtan4> {
  static constexpr int width = 752;
  static constexpr int height = 480;
  static ft::radtan4<double> parameters() {
    return {
        458.654, 457.296, 367.215, 248.375, {-0.28340811, 0.07395907, 0.00019359, 1.76187114e-05}};
  }
};

/// TUM RGB-D, freiburg1.
struct radtan5_lens : camera_contract::description<ft::radtan5> {
  static constexpr int width = 640;
  static constexpr int height = 480;
  static ft::radtan5<double> parameters() {
    return {517.306408,
            516.469215,
            318.643040,
            255.313989,
            {0.262383, -0.953104, -0.005358, 0.002628, 1.163314}};
  }
};

/// As depth cameras have it.
struct radtan8_lens : camera_contract::description<ft::radtan8> {
  static constexpr int width = 640;
  static constexpr int height = 576;
  static ft::radtan8<double> parameters() {
    return {504.7, 504.8, 325.9, 336.2, {5.16, 3.29, -2e-5, 3e-5, 0.165, 5.49, 5.02, 0.87}};
  }
};

}  // namespace camera_contract_radtan_test

FT_CAMERA_CONTRACT(radtan4, camera_contract_radtan_test::radtan4_lens);
FT_CAMERA_CONTRACT(radtan5, camera_contract_radtan_test::radtan5_lens);
FT_CAMERA_CONTRACT(radtan8, camera_contract_radtan_test::radtan8_lens);
