// SPDX-License-Identifier: Apache-2.0
/// @file Pose graphs by Ceres Solver: the oracle of tests, and what ft's times are compared with.
#pragma once

#include <ceres/ceres.h>

#include <Eigen/Cholesky>
#include <Eigen/Core>
#include <Eigen/Geometry>
#include <chrono>
#include <cstddef>
#include <string>
#include <vector>

#include "ft/containers/pose_graph.hpp"

namespace bench {

using pose_block = Eigen::Matrix<double, 7, 1>;  ///< position, quaternion (x, y, z, w)

/// L with L L^T = W, also of a semidefinite W.
inline Eigen::Matrix<double, 6, 6> root_of(ft::pose_graph_edge const& edge) {
  Eigen::Matrix<double, 6, 6> W;
  for (int i = 0, at = 0; i < 6; ++i) {
    for (int j = i; j < 6; ++j) { W(i, j) = W(j, i) = edge.information[at++]; }
  }
  Eigen::SelfAdjointEigenSolver<Eigen::Matrix<double, 6, 6>> const eigen(W);
  return eigen.eigenvectors() * eigen.eigenvalues().cwiseMax(0).cwiseSqrt().asDiagonal();
}

inline Eigen::Matrix3d skew(Eigen::Vector3d const& v) {
  Eigen::Matrix3d S;
  S << 0, -v.z(), v.y(), v.z(), 0, -v.x(), -v.y(), v.x(), 0;
  return S;
}

/// The error of an edge, whitened. Its derivatives are those for a step along the manifold,
/// laid into the first six of seven columns (see body_pose).
class edge_term : public ceres::SizedCostFunction<6, 7, 7> {
public:
  explicit edge_term(ft::pose_graph_edge const& edge)
      : root_(root_of(edge).transpose()),
        t_(edge.T_from_to.t.x, edge.T_from_to.t.y, edge.T_from_to.t.z) {
    Eigen::Matrix<double, 3, 3, Eigen::RowMajor> R(edge.T_from_to.R.m);
    q_ = Eigen::Quaterniond(Eigen::Matrix3d(R)).normalized();
  }

  bool Evaluate(double const* const* x, double* error, double** J) const override {
    Eigen::Map<Eigen::Vector3d const> const ti(x[0]);
    Eigen::Map<Eigen::Vector3d const> const tj(x[1]);
    Eigen::Map<Eigen::Quaterniond const> const qi(x[0] + 3);
    Eigen::Map<Eigen::Quaterniond const> const qj(x[1] + 3);
    Eigen::Vector3d const apart = qi.conjugate() * (tj - ti);
    Eigen::Quaterniond q = q_.conjugate() * (qi.conjugate() * qj);
    if (q.w() < 0) { q.coeffs() = -q.coeffs(); }
    Eigen::Matrix<double, 6, 1> e;
    e.head<3>() = q_.conjugate() * (apart - t_);
    e.tail<3>() = q.vec();
    Eigen::Map<Eigen::Matrix<double, 6, 1>> out(error);
    out = root_ * e;
    if (J == nullptr) { return true; }
    Eigen::Matrix3d const Zt = q_.conjugate().toRotationMatrix();
    Eigen::Matrix3d const I = Eigen::Matrix3d::Identity();
    using rows = Eigen::Matrix<double, 6, 7, Eigen::RowMajor>;
    Eigen::Matrix<double, 6, 7> D = Eigen::Matrix<double, 6, 7>::Zero();
    if (J[0] != nullptr) {
      D.block<3, 3>(0, 0) = -Zt;
      D.block<3, 3>(0, 3) = Zt * skew(apart);
      D.block<3, 3>(3, 3) = -0.5 * (q.w() * I - skew(q.vec())) * Zt;
      Eigen::Map<rows>(J[0], 6, 7) = root_ * D;
    }
    if (J[1] != nullptr) {
      D.setZero();
      D.block<3, 3>(0, 0) = Zt * (qi.conjugate() * qj).toRotationMatrix();
      D.block<3, 3>(3, 3) = 0.5 * (q.w() * I + skew(q.vec()));
      Eigen::Map<rows>(J[1], 6, 7) = root_ * D;
    }
    return true;
  }

private:
  Eigen::Matrix<double, 6, 6> root_;
  Eigen::Vector3d t_;
  Eigen::Quaterniond q_;
};

/// Steps (u, w) of a pose: T -> T (Exp(w), u). Derivatives of cost functions are by the step, so
/// the derivative of the step is the identity.
class body_pose : public ceres::Manifold {
public:
  int AmbientSize() const override { return 7; }
  int TangentSize() const override { return 6; }
  bool Plus(double const* x, double const* d, double* out) const override {
    Eigen::Map<Eigen::Vector3d const> const t(x);
    Eigen::Map<Eigen::Quaterniond const> const q(x + 3);
    Eigen::Map<Eigen::Vector3d const> const u(d);
    Eigen::Map<Eigen::Vector3d const> const w(d + 3);
    double const angle = w.norm();
    Eigen::Quaterniond step(1, 0, 0, 0);
    if (angle > 1e-300) { step = Eigen::AngleAxisd(angle, w / angle); }
    Eigen::Map<Eigen::Vector3d> to(out);
    Eigen::Map<Eigen::Quaterniond> turned(out + 3);
    to = t + q * u;
    turned = (q * step).normalized();
    return true;
  }
  bool PlusJacobian(double const*, double* J) const override {
    Eigen::Map<Eigen::Matrix<double, 7, 6, Eigen::RowMajor>> out(J);
    out.setZero();
    out.topRows<6>().setIdentity();
    return true;
  }
  bool Minus(double const*, double const*, double*) const override { return false; }
  bool MinusJacobian(double const*, double*) const override { return false; }
};

struct ceres_solution {
  double chi2;  ///< robust cost, as sums of e^T W e
  int steps;
  double milliseconds;  ///< construction included
  std::string message;
  std::vector<double> milliseconds_after;  ///< each step, construction included
  std::vector<double> chi2_after;
};

/// Moves a graph's poses to the minimum near them. The first pose stays if none is fixed.
inline ceres_solution solve_by_ceres(ft::pose_graph& graph, int threads) {
  auto const begin = std::chrono::steady_clock::now();
  auto const now = [&] {
    return std::chrono::duration<double, std::milli>(std::chrono::steady_clock::now() - begin)
        .count();
  };
  std::vector<pose_block, Eigen::aligned_allocator<pose_block>> poses;
  for (auto const& T : graph.T_world_pose) {
    Eigen::Matrix<double, 3, 3, Eigen::RowMajor> const R(T.R.m);
    pose_block p;
    p << T.t.x, T.t.y, T.t.z, Eigen::Quaterniond(Eigen::Matrix3d(R)).normalized().coeffs();
    poses.push_back(p);
  }
  ceres::Problem problem;
  body_pose* const manifold = new body_pose;
  for (auto& p : poses) { problem.AddParameterBlock(p.data(), 7, manifold); }
  for (auto const& e : graph.edges) {
    ceres::LossFunction* loss = nullptr;
    if (e.kernel == ft::robust_kernel::huber) { loss = new ceres::HuberLoss(e.width); }
    if (e.kernel == ft::robust_kernel::cauchy) { loss = new ceres::CauchyLoss(e.width); }
    problem.AddResidualBlock(new edge_term(e), loss, poses[static_cast<std::size_t>(e.from)].data(),
                             poses[static_cast<std::size_t>(e.to)].data());
  }
  if (graph.fixed.empty()) { problem.SetParameterBlockConstant(poses[0].data()); }
  for (std::size_t i = 0; i < graph.fixed.size(); ++i) {
    if (graph.fixed[i] != 0) { problem.SetParameterBlockConstant(poses[i].data()); }
  }
  ceres::Solver::Options options;
  options.linear_solver_type = ceres::SPARSE_NORMAL_CHOLESKY;
  options.num_threads = threads;
  options.max_num_iterations = 200;
  options.function_tolerance = 1e-12;
  options.gradient_tolerance = 1e-14;
  options.parameter_tolerance = 1e-14;
  options.logging_type = ceres::SILENT;
  double const made = now();
  ceres::Solver::Summary summary;
  ceres::Solve(options, &problem, &summary);
  ceres_solution found{2 * summary.final_cost,
                       static_cast<int>(summary.iterations.size()) - 1,
                       now(),
                       ceres::TerminationTypeToString(summary.termination_type),
                       {},
                       {}};
  for (auto const& step : summary.iterations) {
    found.milliseconds_after.push_back(made + 1e3 * step.cumulative_time_in_seconds);
    found.chi2_after.push_back(2 * step.cost);
  }
  for (std::size_t i = 0; i < poses.size(); ++i) {
    Eigen::Map<Eigen::Quaterniond const> const q(poses[i].data() + 3);
    Eigen::Matrix<double, 3, 3, Eigen::RowMajor> const R = q.toRotationMatrix();
    ft::rigid<double>& T = graph.T_world_pose[i];
    for (int k = 0; k < 9; ++k) { T.R.m[k] = R.data()[k]; }
    T.t = {poses[i][0], poses[i][1], poses[i][2]};
  }
  return found;
}

}  // namespace bench
