// SPDX-License-Identifier: Apache-2.0
// Every camera model of the library keeps the contract. A new model: a description with a real
// calibration, and a line at the end. Several files, since each model compiles every stage.
#include "tests/camera_contract.hpp"
#include "ft/cameras/kannala_brandt.hpp"
#include "ft/cameras/pinhole.hpp"

namespace camera_contract_test {

/// EuRoC's left camera.
struct pinhole_lens : camera_contract::description<ft::pinhole> {
  static constexpr int width = 752;
  static constexpr int height = 480;
  static ft::pinhole<double> parameters() { return {458.654, 457.296, 367.215, 248.375}; }
};

/// TUM-VI's left camera.
struct kannala_brandt_lens : camera_contract::description<ft::kannala_brandt> {
  static constexpr int width = 512;
  static constexpr int height = 512;
  static constexpr bool sees_behind = true;
  static ft::kannala_brandt<double> parameters() {
    return {190.97847715128717,     190.9733070521226,     254.93170605935475,
            256.8974428996504,      0.0034823894022493434, 0.0007150348452162257,
            -0.0020532361418706202, 0.00020293673591811182};
  }
};

}  // namespace camera_contract_test

FT_CAMERA_CONTRACT(pinhole, camera_contract_test::pinhole_lens);
FT_CAMERA_CONTRACT(kannala_brandt, camera_contract_test::kannala_brandt_lens);
