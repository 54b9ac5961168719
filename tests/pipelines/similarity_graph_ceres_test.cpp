// SPDX-License-Identifier: Apache-2.0
// Graphs of poses with scales against Ceres Solver: the same errors written again, with automatic
// derivatives.
#include <ceres/ceres.h>
#include <gtest/gtest.h>

#include <Eigen/Core>
#include <Eigen/Eigenvalues>
#include <Eigen/Geometry>
#include <algorithm>
#include <cmath>
#include <cstddef>
#include <vector>

#include "tests/support/pose_graph_checks.hpp"
#include "tests/support/pose_graphs.hpp"

namespace similarity_graph_ceres_test {

using row_major = Eigen::Matrix<double, 3, 3, Eigen::RowMajor>;

struct block {
  Eigen::Vector3d t;
  Eigen::Quaterniond q;
  double log_scale;
};

inline block block_of(ft::similarity<double> const& T) {
  return {{T.t.x, T.t.y, T.t.z},
          Eigen::Quaterniond(Eigen::Matrix3d(Eigen::Map<row_major const>(T.R.m))).normalized(),
          std::log(T.scale)};
}

/// The error of an edge, whitened.
struct edge_error {
  explicit edge_error(ft::similarity_edge const& edge) : Z(block_of(edge.T_from_to)) {
    Eigen::Matrix<double, 7, 7> W;
    for (int i = 0, at = 0; i < 7; ++i) {
      for (int j = i; j < 7; ++j) { W(i, j) = W(j, i) = edge.information[at++]; }
    }
    root = Eigen::LLT<Eigen::Matrix<double, 7, 7>>(W).matrixU();
  }

  template <typename T>
  bool operator()(T const* ti, T const* qi, T const* si, T const* tj, T const* qj, T const* sj,
                  T* out) const {
    using vector = Eigen::Matrix<T, 3, 1>;
    using rotation = Eigen::Quaternion<T>;
    Eigen::Map<rotation const> const Qi(qi);
    Eigen::Map<rotation const> const Qj(qj);
    rotation const Qz = Z.q.cast<T>();
    vector const apart = Eigen::Map<vector const>(tj) - Eigen::Map<vector const>(ti);
    vector const seen = Qi.conjugate() * apart / exp(*si);
    rotation left = Qz.conjugate() * (Qi.conjugate() * Qj);
    if (left.w() < T(0)) { left.coeffs() = -left.coeffs(); }
    Eigen::Matrix<T, 7, 1> e;
    e.template head<3>() = Qz.conjugate() * (seen - Z.t.cast<T>()) / T(std::exp(Z.log_scale));
    e.template segment<3>(3) = left.vec();
    e[6] = *sj - *si - T(Z.log_scale);
    Eigen::Map<Eigen::Matrix<T, 7, 1>> whitened(out);
    whitened = root.cast<T>() * e;
    return true;
  }

  block Z;
  Eigen::Matrix<double, 7, 7> root;
};

/// Moves the poses to the minimum near them. Returns the robust cost, as sums of e^T W e.
inline double solve(ft::similarity_graph& graph) {
  std::vector<block> poses;
  for (auto const& T : graph.T_world_pose) { poses.push_back(block_of(T)); }
  ceres::Problem problem;
  auto* const unit = new ceres::EigenQuaternionManifold;
  for (auto& p : poses) { problem.AddParameterBlock(p.q.coeffs().data(), 4, unit); }
  for (auto const& e : graph.edges) {
    ceres::LossFunction* loss = nullptr;
    if (e.kernel == ft::robust_kernel::huber) { loss = new ceres::HuberLoss(e.width); }
    if (e.kernel == ft::robust_kernel::cauchy) { loss = new ceres::CauchyLoss(e.width); }
    block& from = poses[static_cast<std::size_t>(e.from)];
    block& to = poses[static_cast<std::size_t>(e.to)];
    problem.AddResidualBlock(
        new ceres::AutoDiffCostFunction<edge_error, 7, 3, 4, 1, 3, 4, 1>(new edge_error(e)), loss,
        from.t.data(), from.q.coeffs().data(), &from.log_scale, to.t.data(), to.q.coeffs().data(),
        &to.log_scale);
  }
  for (std::size_t i = 0; i < poses.size(); ++i) {
    if (graph.fixed.empty() ? i > 0 : graph.fixed[i] == 0) { continue; }
    problem.SetParameterBlockConstant(poses[i].t.data());
    problem.SetParameterBlockConstant(poses[i].q.coeffs().data());
    problem.SetParameterBlockConstant(&poses[i].log_scale);
  }
  ceres::Solver::Options options;
  options.linear_solver_type = ceres::SPARSE_NORMAL_CHOLESKY;
  options.max_num_iterations = 200;
  options.function_tolerance = 1e-13;
  options.gradient_tolerance = 1e-14;
  options.parameter_tolerance = 1e-14;
  options.logging_type = ceres::SILENT;
  ceres::Solver::Summary summary;
  ceres::Solve(options, &problem, &summary);
  for (std::size_t i = 0; i < poses.size(); ++i) {
    ft::similarity<double>& T = graph.T_world_pose[i];
    row_major const R = poses[i].q.toRotationMatrix();
    std::copy(R.data(), R.data() + 9, T.R.m);
    T.t = {poses[i].t.x(), poses[i].t.y(), poses[i].t.z()};
    T.scale = std::exp(poses[i].log_scale);
  }
  return 2 * summary.final_cost;
}

TEST(SimilarityGraphCeres, Agrees) {
  test::expect_agreement_of_all(test::make_similarity_graph, solve);
}

}  // namespace similarity_graph_ceres_test
