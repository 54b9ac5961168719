// SPDX-License-Identifier: Apache-2.0
// Poses with an IMU against Ceres Solver: the same errors, written out again from the paper and
// differentiated automatically, over the observations that are inliers in the end.
#include <ceres/ceres.h>
#include <ceres/rotation.h>
#include <gtest/gtest.h>

#include <Eigen/Dense>
#include <array>
#include <cmath>
#include <cstddef>
#include <vector>

#include "ft/core/execution.hpp"
#include "tests/support/inertial_scene.hpp"

namespace inertial_pose_ceres_test {

using test::inertial_pose_batch;
using test::inertial_scene;
using state = ft::inertial_state<double>;
/// Rotation as an angle about an axis, body to world; position; velocity; biases.
using unknowns = std::array<double, 15>;

inline void to_column_major(ft::mat3<double> const& R, double* out) {
  for (int i = 0; i < 3; ++i) {
    for (int j = 0; j < 3; ++j) { out[3 * j + i] = R.m[3 * i + j]; }
  }
}
inline unknowns unknowns_of(state const& s) {
  double R[9];
  to_column_major(s.R, R);
  unknowns x{};
  ceres::RotationMatrixToAngleAxis(R, x.data());
  ft::vec3<double> const parts[4] = {s.p, s.v, s.bg, s.ba};
  for (std::size_t k = 0; k < 4; ++k) {
    x[3 + 3 * k] = parts[k].x;
    x[4 + 3 * k] = parts[k].y;
    x[5 + 3 * k] = parts[k].z;
  }
  return x;
}

template <typename T>
using vector3 = Eigen::Matrix<T, 3, 1>;
template <typename T>
using matrix3 = Eigen::Matrix<T, 3, 3>;

template <typename T>
matrix3<T> exponential(vector3<T> const& w) {
  matrix3<T> R;
  ceres::AngleAxisToRotationMatrix(w.data(), R.data());
  return R;
}
template <typename T>
vector3<T> logarithm(matrix3<T> const& R) {
  vector3<T> w;
  ceres::RotationMatrixToAngleAxis(R.data(), w.data());
  return w;
}
template <typename T>
vector3<T> part(T const* x, int k) {
  return {x[3 * k], x[3 * k + 1], x[3 * k + 2]};
}
inline Eigen::Matrix3d eigen(ft::mat3<float> const& m) {
  Eigen::Matrix3d out;
  for (int i = 0; i < 9; ++i) { out(i / 3, i % 3) = static_cast<double>(m.m[i]); }
  return out;
}
inline Eigen::Vector3d eigen(ft::vec3<float> v) { return {v.x, v.y, v.z}; }
/// L^T with L L^T = the matrix.
template <typename Matrix>
Matrix root_of(Matrix const& information) {
  return information.llt().matrixU();
}

struct integral_error {
  ft::preintegrated integral;
  Eigen::Matrix<double, 9, 9> root;

  template <typename T>
  bool operator()(T const* one, T const* two, T* error) const {
    T const t = T(static_cast<double>(integral.dT));
    vector3<T> const g(T(0), T(0), T(-static_cast<double>(9.81f)));
    auto const wide = [](ft::mat3<float> const& m) { return matrix3<T>(eigen(m).cast<T>()); };
    auto const wide_v = [](ft::vec3<float> v) { return vector3<T>(eigen(v).cast<T>()); };
    vector3<T> const dg = part(one, 3) - wide_v(integral.bias.gyro);
    vector3<T> const da = part(one, 4) - wide_v(integral.bias.accel);
    matrix3<T> const R1 = exponential<T>(part(one, 0));
    matrix3<T> const R2 = exponential<T>(part(two, 0));
    matrix3<T> const dR = wide(integral.dR) * exponential<T>(wide(integral.JRg) * dg);
    Eigen::Matrix<T, 9, 1> e;
    e.template segment<3>(0) = logarithm<T>(dR.transpose() * R1.transpose() * R2);
    e.template segment<3>(3) =
        R1.transpose() * (part(two, 2) - part(one, 2) - g * t) -
        (wide_v(integral.dV) + wide(integral.JVg) * dg + wide(integral.JVa) * da);
    e.template segment<3>(6) =
        R1.transpose() * (part(two, 1) - part(one, 1) - part(one, 2) * t - g * (t * t / 2.0)) -
        (wide_v(integral.dP) + wide(integral.JPg) * dg + wide(integral.JPa) * da);
    Eigen::Map<Eigen::Matrix<T, 9, 1>>(error, 9) = root.cast<T>() * e;
    return true;
  }
};

struct walk_error {
  double root[6];
  template <typename T>
  bool operator()(T const* one, T const* two, T* error) const {
    for (int k = 0; k < 6; ++k) { error[k] = root[k] * (two[9 + k] - one[9 + k]); }
    return true;
  }
};

struct prior_error {
  unknowns prior;
  Eigen::Matrix<double, 15, 15> root;
  template <typename T>
  bool operator()(T const* x, T* error) const {
    T p[15];
    for (std::size_t k = 0; k < 15; ++k) { p[k] = T(prior[k]); }
    matrix3<T> const Rt = exponential<T>(part(p, 0)).transpose();
    Eigen::Matrix<T, 15, 1> e;
    e.template segment<3>(0) = logarithm<T>(Rt * exponential<T>(part(x, 0)));
    e.template segment<3>(3) = Rt * (part(x, 1) - part(p, 1));
    for (int k = 6; k < 15; ++k) { e[k] = x[k] - p[k]; }
    Eigen::Map<Eigen::Matrix<T, 15, 1>>(error, 15) = root.cast<T>() * e;
    return true;
  }
};

template <typename Rig>
struct sighting_error {
  Rig rig;
  ft::imu_mount mount;
  ft::observation seen;
  template <typename T>
  bool operator()(T const* x, T* error) const {
    vector3<T> const in_body =
        exponential<T>(part(x, 0)).transpose() * (eigen(seen.point).cast<T>() - part(x, 1));
    auto const image = test::image_in(
        rig, seen.camera, test::moved(mount.T_cb, ft::vec3<T>{in_body[0], in_body[1], in_body[2]}));
    double const scale = std::sqrt(static_cast<double>(seen.inv_sigma2));
    error[0] = scale * (static_cast<double>(seen.u) - image.pixel.x);
    error[1] = scale * (static_cast<double>(seen.v) - image.pixel.y);
    error[2] = T(0);
    if (seen.right_u >= 0) {
      error[2] = scale * (static_cast<double>(seen.right_u) - image.right_u);
    }
    return true;
  }
};

/// The least squares of the frame's problem: no robust weights but the prior's, as in the last
/// round.
template <typename Rig>
unknowns solve_by_ceres(inertial_scene<Rig> const& scene, inertial_pose_batch const& b,
                        std::size_t i) {
  auto const wide_state = [&](ft::stored_inertial_state const& s) {
    auto const f = ft::body_state(s, scene.mount);
    return state{f.R.template cast<double>(), f.p.template cast<double>(),
                 f.v.template cast<double>(), f.bg.template cast<double>(),
                 f.ba.template cast<double>()};
  };
  unknowns one = unknowns_of(wide_state(b.first[i]));
  unknowns two = unknowns_of(wide_state(b.start[i]));
  ceres::Problem problem;
  auto const& integral = b.integral[i];
  Eigen::Matrix<double, 9, 9> C;
  for (int k = 0; k < 81; ++k) { C(k / 9, k % 9) = static_cast<double>(integral.C[k]); }
  C = (C + C.transpose()).eval() / 2;
  problem.AddResidualBlock(
      new ceres::AutoDiffCostFunction<integral_error, 9, 15, 15>(
          new integral_error{integral, root_of<Eigen::Matrix<double, 9, 9>>(C.inverse())}),
      nullptr, one.data(), two.data());
  auto* const walk = new walk_error;
  for (int k = 0; k < 6; ++k) {
    walk->root[k] = 1 / std::sqrt(static_cast<double>(integral.walk[k]));
  }
  problem.AddResidualBlock(new ceres::AutoDiffCostFunction<walk_error, 6, 15, 15>(walk), nullptr,
                           one.data(), two.data());
  if (b.from_last_frame[i] != 0) {
    Eigen::Matrix<double, 15, 15> H;
    for (int k = 0; k < 225; ++k) { H(k / 15, k % 15) = b.prior[i].information[k]; }
    problem.AddResidualBlock(
        new ceres::AutoDiffCostFunction<prior_error, 15, 15>(new prior_error{
            unknowns_of(b.prior[i].state), root_of<Eigen::Matrix<double, 15, 15>>(H)}),
        new ceres::HuberLoss(5), one.data());
  } else {
    problem.SetParameterBlockConstant(one.data());
  }
  for (int k = 0; k < b.count[i]; ++k) {
    if (b.outlier[b.at(i, k)] != 0) { continue; }
    problem.AddResidualBlock(
        new ceres::AutoDiffCostFunction<sighting_error<Rig>, 3, 15>(new sighting_error<Rig>{
            scene.rig, scene.mount, b.observations[i][static_cast<std::size_t>(k)]}),
        nullptr, two.data());
  }
  ceres::Solver::Options options;
  options.linear_solver_type = ceres::DENSE_QR;
  options.max_num_iterations = 200;
  options.function_tolerance = 1e-16;
  options.gradient_tolerance = 1e-16;
  options.parameter_tolerance = 1e-14;
  options.logging_type = ceres::SILENT;
  ceres::Solver::Summary summary;
  ceres::Solve(options, &problem, &summary);
  EXPECT_TRUE(summary.IsSolutionUsable()) << summary.message;
  return two;
}

template <typename Rig>
void compare(unsigned seed) {
  inertial_scene<Rig> scene(seed);
  inertial_pose_batch b;
  for (int i = 0; i < 6; ++i) {
    test::inertial_shape shape;
    shape.observations = 60 + 40 * i;
    shape.from_last_frame = i % 2 == 1;
    shape.pixel_noise = 0.7;
    shape.outliers_percent = 10;
    shape.imu_steps = 4 + 4 * i;
    scene.add(b, shape);
  }
  test::optimize(ft::host_exec(1), scene.rig, scene.mount, {}, b);
  for (std::size_t i = 0; i < b.size(); ++i) {
    ASSERT_EQ(b.result[i].status, ft::inertial_pose_status::optimised);
    ASSERT_GE(b.result[i].inliers, 30);  // none is taken in again after the last round
    auto const want = solve_by_ceres(scene, b, i);
    auto const got = unknowns_of(b.result[i].round_state[3]);
    // Stored states are floats, so their matrices are rotations to 1e-7 only. The optimum of angles
    // that are floats is a little elsewhere, too.
    double const scale = Rig::rectified ? 1 : 10;
    double const limits[5] = {1e-6, 1e-6, 5e-6, 1e-6, 1e-5};
    for (std::size_t k = 0; k < 15; ++k) {
      EXPECT_NEAR(got[k], want[k], scale * limits[k / 3]) << seed << " " << i << " " << k;
    }
  }
}

TEST(inertial_pose_ceres, the_optimum_is_that_of_a_general_solver) {
  for (unsigned seed = 1; seed <= 2; ++seed) {
    compare<ft::rectified_rig>(seed);
    compare<test::inertial_fisheye_rig>(seed);
    compare<ft::multi_rig<3>>(seed);
  }
}

}  // namespace inertial_pose_ceres_test
