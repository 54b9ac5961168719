// SPDX-License-Identifier: Apache-2.0
#include "examples/track_sequence/local_adjustment.hpp"

#include <Eigen/Cholesky>
#include <Eigen/Core>
#include <Eigen/Geometry>
#include <algorithm>
#include <cmath>
#include <cstddef>
#include <utility>

#include "ft/cameras/kannala_brandt.hpp"
#include "ft/cameras/pinhole.hpp"

namespace app {

namespace {

using matrix23 = Eigen::Matrix<double, 2, 3>;
using matrix26 = Eigen::Matrix<double, 2, 6>;
using matrix63 = Eigen::Matrix<double, 6, 3>;
using matrix6 = Eigen::Matrix<double, 6, 6>;
using vector6 = Eigen::Matrix<double, 6, 1>;
using rotation = Eigen::Matrix<double, 3, 3, Eigen::RowMajor>;

constexpr double huber2 = 5.991;    // squared error from which the cost grows linearly
constexpr double no_image = 100.0;  // cost of a point that a camera cannot see

struct motion {
  rotation R;
  Eigen::Vector3d t;
};

motion motion_of(rigid_pose const& T) {
  return {Eigen::Map<rotation const>(T.R.data()), Eigen::Map<Eigen::Vector3d const>(T.t.data())};
}

Eigen::Matrix3d cross(Eigen::Vector3d const& v) {
  Eigen::Matrix3d m;
  m << 0, -v.z(), v.y(), v.z(), 0, -v.x(), -v.y(), v.x(), 0;
  return m;
}

double robust(double chi2) { return chi2 <= huber2 ? chi2 : 2 * std::sqrt(huber2 * chi2) - huber2; }

/// Two Kannala-Brandt cameras, each with its own errors.
class fisheye_pair {
public:
  explicit fisheye_pair(odometry_options const& o)
      : cameras_{model(o.left), model(o.right)}, T_(motion_of(o.T_right_left)) {}

  /// @param x in the left camera's frame
  bool project(int camera, Eigen::Vector3d const& x, Eigen::Vector2d& pixel) const {
    Eigen::Vector3d const y = in(camera, x);
    auto const p = cameras_[static_cast<std::size_t>(camera)].project({y.x(), y.y(), y.z()});
    pixel = {p.pixel.x, p.pixel.y};
    return p.valid;
  }
  matrix23 jacobian(int camera, Eigen::Vector3d const& x) const {
    Eigen::Vector3d const y = in(camera, x);
    auto const& model = cameras_[static_cast<std::size_t>(camera)];
    auto const j = model.project_with_jacobian({y.x(), y.y(), y.z()}).jacobian;
    matrix23 J;
    J << j.m[0], j.m[1], j.m[2], j.m[3], j.m[4], j.m[5];
    return camera == 0 ? J : matrix23(J * T_.R);
  }

private:
  using camera_model = ft::kannala_brandt<double>;

  static camera_model model(std::array<double, 8> const& p) {
    return {p[0], p[1], p[2], p[3], p[4], p[5], p[6], p[7]};
  }
  Eigen::Vector3d in(int camera, Eigen::Vector3d const& x) const {
    return camera == 0 ? x : Eigen::Vector3d(T_.R * x + T_.t);
  }

  std::array<camera_model, 2> cameras_;
  motion T_;
};

/// A rectified pair: pixels of the left camera, and disparities.
class rectified_pair {
public:
  explicit rectified_pair(odometry_options const& o)
      : left_{o.fx, o.fy, o.cx, o.cy}, bf_(o.baseline * o.fx) {}

  bool project(int camera, Eigen::Vector3d const& x, Eigen::Vector2d& pixel) const {
    auto const p = left_.project({x.x(), x.y(), x.z()});
    pixel = camera == 0 ? Eigen::Vector2d(p.pixel.x, p.pixel.y) : Eigen::Vector2d(bf_ / x.z(), 0);
    return p.valid;
  }
  matrix23 jacobian(int camera, Eigen::Vector3d const& x) const {
    auto const j = left_.project_with_jacobian({x.x(), x.y(), x.z()}).jacobian;
    matrix23 J;
    if (camera == 0) {
      J << j.m[0], j.m[1], j.m[2], j.m[3], j.m[4], j.m[5];
    } else {
      J << 0, 0, -bf_ / (x.z() * x.z()), 0, 0, 0;
    }
    return J;
  }

private:
  ft::pinhole<double> left_;
  double bf_;
};

/// The sums of a linearisation that belong to one point.
struct point_terms {
  Eigen::Matrix3d H = Eigen::Matrix3d::Zero();
  Eigen::Vector3d b = Eigen::Vector3d::Zero();
  std::size_t first = 0, last = 0;  ///< range in solver::links
};

/// A point and a view that is not fixed.
struct link {
  std::size_t view;  ///< counted from the first view that is not fixed
  matrix63 W;
};

template <typename Rig>
class solver {
public:
  solver(odometry_options const& rig, adjustment& a) : rig_(rig), a_(a) {}

  std::vector<double> run(int steps) {
    auto const fixed = static_cast<std::size_t>(a_.fixed);
    std::size_t const moving = a_.views.size() - fixed;
    std::vector<double> errors = errors_of(a_.views, a_.points);
    double cost = cost_of(errors);
    double damping = 1e-4;
    bool fresh = false;
    for (int step = 0; step < steps; ++step) {
      if (!fresh) { linearize(moving); }
      fresh = true;
      std::vector<rigid_pose> views = a_.views;
      std::vector<std::array<double, 3>> points = a_.points;
      if (!solve(moving, damping, views, points)) { break; }
      std::vector<double> errors_then = errors_of(views, points);
      double const then = cost_of(errors_then);
      if (then < cost) {
        bool const done = cost - then < 1e-4 * cost;
        a_.views = std::move(views);
        a_.points = std::move(points);
        errors = std::move(errors_then);
        cost = then;
        damping = std::max(damping * 0.1, 1e-8);
        fresh = false;
        if (done) { break; }
      } else {
        damping *= 10;
      }
    }
    return errors;
  }

private:
  /// Squared weighted errors; negative where a point has no image.
  std::vector<double> errors_of(std::vector<rigid_pose> const& views,
                                std::vector<std::array<double, 3>> const& points) const {
    std::vector<motion> const T = motions_of(views);
    std::vector<double> errors;
    errors.reserve(a_.sightings.size());
    for (auto const& s : a_.sightings) {
      Eigen::Vector2d e;
      bool const seen = error(s, in_view(T, points, s), e);
      errors.push_back(seen ? s.weight * e.squaredNorm() : -1.0);
    }
    return errors;
  }
  static double cost_of(std::vector<double> const& errors) {
    double sum = 0;
    for (double chi2 : errors) { sum += chi2 >= 0 ? robust(chi2) : no_image; }
    return sum;
  }

  static std::vector<motion> motions_of(std::vector<rigid_pose> const& views) {
    std::vector<motion> T;
    for (auto const& v : views) { T.push_back(motion_of(v)); }
    return T;
  }
  /// The point in the left camera's frame.
  static Eigen::Vector3d in_view(std::vector<motion> const& T,
                                 std::vector<std::array<double, 3>> const& points,
                                 sighting const& s) {
    auto const& view = T[static_cast<std::size_t>(s.view)];
    auto const& point = points[static_cast<std::size_t>(s.point)];
    return view.R * Eigen::Map<Eigen::Vector3d const>(point.data()) + view.t;
  }

  /// @param x in the left camera's frame
  /// @param e pixels, projected minus measured
  bool error(sighting const& s, Eigen::Vector3d const& x, Eigen::Vector2d& e) const {
    bool const valid = rig_.project(s.camera, x, e);
    e -= Eigen::Vector2d(s.u, s.v);
    return valid && e.allFinite();
  }

  void linearize(std::size_t moving) {
    terms_.assign(a_.points.size(), {});
    links_.clear();
    H_.assign(moving, matrix6::Zero());
    b_.assign(moving, vector6::Zero());
    auto const fixed = static_cast<std::size_t>(a_.fixed);
    std::vector<motion> const T = motions_of(a_.views);
    std::size_t point = a_.points.size();
    for (auto const& s : a_.sightings) {
      auto const p = static_cast<std::size_t>(s.point);
      auto const v = static_cast<std::size_t>(s.view);
      auto& t = terms_[p];
      if (p != point) { t.first = t.last = links_.size(); }
      point = p;
      Eigen::Vector3d const x = in_view(T, a_.points, s);
      Eigen::Vector2d e;
      if (!error(s, x, e)) { continue; }
      matrix23 const J = rig_.jacobian(s.camera, x);
      if (!J.allFinite()) { continue; }
      double const chi2 = s.weight * e.squaredNorm();
      double const w = chi2 <= huber2 ? s.weight : s.weight * std::sqrt(huber2 / chi2);
      matrix23 const Jp = J * T[v].R;
      t.H += w * Jp.transpose() * Jp;
      t.b -= w * Jp.transpose() * e;
      if (v < fixed) { continue; }
      matrix26 Jv;  // rotation first; x -> x + omega x x + u
      Jv << -J * cross(x), J;
      H_[v - fixed] += w * Jv.transpose() * Jv;
      b_[v - fixed] -= w * Jv.transpose() * e;
      matrix63 const W = w * Jv.transpose() * Jp;
      if (t.last > t.first && links_.back().view == v - fixed) {
        links_.back().W += W;
      } else {
        links_.push_back({v - fixed, W});
        t.last = links_.size();
      }
    }
  }

  bool solve(std::size_t moving, double damping, std::vector<rigid_pose>& views,
             std::vector<std::array<double, 3>>& points) {
    auto const at = [](std::size_t v) { return static_cast<Eigen::Index>(6 * v); };
    Eigen::MatrixXd S = Eigen::MatrixXd::Zero(at(moving), at(moving));
    Eigen::VectorXd r(at(moving));
    for (std::size_t v = 0; v < moving; ++v) {
      matrix6 H = H_[v];
      H.diagonal() *= 1 + damping;
      H.diagonal().array() += 1e-9;
      S.block<6, 6>(at(v), at(v)) = H;
      r.segment<6>(at(v)) = b_[v];
    }
    inverses_.resize(terms_.size());
    for (std::size_t p = 0; p < terms_.size(); ++p) {
      auto const& t = terms_[p];
      Eigen::Matrix3d H = t.H;
      H.diagonal() *= 1 + damping;
      H.diagonal().array() += 1e-9;
      inverses_[p] = H.inverse();
      for (std::size_t i = t.first; i < t.last; ++i) {
        matrix63 const Y = links_[i].W * inverses_[p];
        r.segment<6>(at(links_[i].view)) -= Y * t.b;
        for (std::size_t k = t.first; k <= i; ++k) {  // views ascend: the lower triangle
          S.block<6, 6>(at(links_[i].view), at(links_[k].view)).noalias() -=
              Y * links_[k].W.transpose();
        }
      }
    }
    Eigen::LDLT<Eigen::MatrixXd, Eigen::Lower> const factors(S);
    Eigen::VectorXd const d = factors.solve(r);
    if (factors.info() != Eigen::Success || !d.allFinite()) { return false; }
    for (std::size_t p = 0; p < terms_.size(); ++p) {
      auto const& t = terms_[p];
      Eigen::Vector3d b = t.b;
      for (std::size_t i = t.first; i < t.last; ++i) {
        b -= links_[i].W.transpose() * d.segment<6>(at(links_[i].view));
      }
      Eigen::Map<Eigen::Vector3d>(points[p].data()) += inverses_[p] * b;
    }
    for (std::size_t v = 0; v < moving; ++v) {
      rigid_pose& T = views[v + static_cast<std::size_t>(a_.fixed)];
      vector6 const step = d.segment<6>(at(v));
      Eigen::Vector3d const omega = step.head<3>();
      double const angle = omega.norm();
      rotation const turn =
          angle > 0 ? rotation(Eigen::AngleAxisd(angle, omega / angle).toRotationMatrix())
                    : rotation(rotation::Identity());
      motion const before = motion_of(T);
      Eigen::Map<rotation>(T.R.data()) = turn * before.R;
      Eigen::Map<Eigen::Vector3d>(T.t.data()) = turn * before.t + step.tail<3>();
      T.orthonormalize();
    }
    return true;
  }

  Rig rig_;
  adjustment& a_;
  std::vector<point_terms> terms_;
  std::vector<link> links_;
  std::vector<matrix6> H_;
  std::vector<vector6> b_;
  std::vector<Eigen::Matrix3d> inverses_;
};

}  // namespace

std::vector<double> adjust(odometry_options const& rig, adjustment& a, int steps) {
  return rig.fisheye ? solver<fisheye_pair>(rig, a).run(steps)
                     : solver<rectified_pair>(rig, a).run(steps);
}

}  // namespace app
