// SPDX-License-Identifier: Apache-2.0
/// @file Compares the reconstruction from two views with golden_words, by the tolerances of
/// FORMAT.md there.
#pragma once

#include <algorithm>
#include <array>
#include <cmath>
#include <cstddef>
#include <cstdint>
#include <cstdlib>
#include <functional>
#include <string>
#include <vector>

#include "ft/kernels/two_view/reconstruct.hpp"
#include "tests/conformance/golden_sequence.hpp"
#include "tests/support/memory.hpp"
#include "tests/support/npy.hpp"

namespace test {

/// What a reconstruction wrote.
struct two_view_answer {
  ft::two_view_result result;
  std::vector<ft::vec3<float>> points;
  std::vector<std::uint8_t> flags;
  std::vector<double> scores;  ///< of homographies, then of fundamental matrices
};

/// A recorded pair of images, on one executor.
template <typename Exec>
class golden_two_view {
public:
  golden_two_view(Exec const& exec, std::string const& folder)
      : exec_(exec),
        folder_(folder),
        p1_(read_npy<float>(folder + "/p1.npy")),
        p2_(read_npy<float>(folder + "/p2.npy")),
        matches_(read_npy<std::int32_t>(folder + "/matches.npy")) {}

  void run(conformance_table& table) const {
    auto const want_ok = read<std::int32_t>("ok_useH");
    ft::two_view_params const params;
    auto const got = reconstruct(params);
    auto& r = table["two_view"];
    r.add((got.result.status == ft::two_view_status::reconstructed) == (want_ok(0) != 0));
    r.add((got.result.model == ft::two_view_model::homography) == (want_ok(1) != 0));
    compare_scores(table["two_view_scores"], got);
    // The golden files have both models' inliers, and the motions of the fundamental matrix.
    auto always_H = params;
    always_H.homography_ratio = -1;
    compare_inliers(r, reconstruct(always_H), "inlier_H");
    auto always_F = params;
    always_F.homography_ratio = 2;
    auto const by_F = reconstruct(always_F);
    compare_inliers(r, by_F, "inlier_F");
    compare_counts(r, by_F);
    if (want_ok(0) != 0) { compare_points(table, got); }
  }

private:
  template <typename T>
  npy<T> read(char const* name) const {
    return read_npy<T>(folder_ + "/" + name + ".npy");
  }

  ft::soa<Exec::space, ft::field::x, ft::field::y> pixels_of(npy<float> const& from) const {
    std::vector<float> x;
    std::vector<float> y;
    for (int i = 0; i < from.rows(); ++i) {
      x.push_back(from(i, 0));
      y.push_back(from(i, 1));
    }
    ft::soa<Exec::space, ft::field::x, ft::field::y> to(from.rows());
    set_pixels(exec_, to.view(), x, y, {from.rows()});
    return to;
  }

  two_view_answer reconstruct(ft::two_view_params const& params) const {
    auto const first = pixels_of(p1_);
    auto const second = pixels_of(p2_);
    int const n = p1_.rows();
    std::vector<int> match(static_cast<std::size_t>(n), -1);
    for (int i = 0; i < matches_.rows(); ++i) {
      match.at(static_cast<std::size_t>(matches_(i, 0))) = matches_(i, 1);
    }
    auto const K = read<float>("K");
    auto const d_match = to_exec(exec_, match);
    auto const d_camera =
        to_exec(exec_, std::vector<ft::pinhole<float>>{{K(0, 0), K(1, 1), K(0, 2), K(1, 2)}});
    auto const d_seed = to_exec(exec_, read<std::uint64_t>("seed").data);
    ft::owner<ft::two_view_reconstructions, Exec::space> const out(
        [&](ft::carver& c, auto& v) { carve(c, v, 1, n); });
    ft::owner<ft::two_view_workspace, Exec::space> const work(
        [&](ft::carver& c, auto& v) { carve(c, v, 1, n, params.samples); });
    ft::reconstruct_two_views(
        exec_, {first.view(), second.view(), d_match.data(), d_camera.data(), d_seed.data()},
        params, out.view(), work.view());
    auto const count = static_cast<std::size_t>(n);
    return {from_exec(exec_, out->result, 1)[0], from_exec(exec_, out->point, count),
            from_exec(exec_, out->flags, count),
            from_exec(exec_, work->score, 2 * static_cast<std::size_t>(params.samples))};
  }

  static double relative(double got, double want) {
    return got == want ? 0 : std::abs(got - want) / std::abs(want);
  }
  static int first_largest(npy<float> const& scores) {
    return static_cast<int>(std::max_element(scores.data.begin(), scores.data.end()) -
                            scores.data.begin());
  }

  void compare_scores(stage_result& r, two_view_answer const& got) const {
    auto const H = read<float>("score_H");
    auto const F = read<float>("score_F");
    int const samples = H.rows();
    for (int model = 0; model < 2; ++model) {
      auto const& want = model == 0 ? H : F;
      int near = 0;
      for (int i = 0; i < samples; ++i) {
        double const g = got.scores.at(static_cast<std::size_t>(model * samples + i));
        near += static_cast<int>(relative(g, static_cast<double>(want(i))) <= 1e-3);
      }
      double const far = 1 - near / static_cast<double>(samples);
      r.add(far <= 0.05, far);
    }
    r.add(got.result.sample_H == first_largest(H));
    r.add(got.result.sample_F == first_largest(F));
    auto const sums = read<float>("SH_SF_RH");
    auto const add = [&](float a, float b, double tolerance, bool by_size) {
      double const d = by_size ? relative(static_cast<double>(a), static_cast<double>(b))
                               : std::abs(static_cast<double>(a - b));
      r.add(d <= tolerance, d);
    };
    add(got.result.score_H, sums(0), 1e-4, true);
    add(got.result.score_F, sums(1), 1e-4, true);
    add(got.result.ratio, sums(2), 1e-5, false);
  }

  void compare_inliers(stage_result& r, two_view_answer const& got, char const* name) const {
    auto const want = read<std::uint8_t>(name);
    int differing = 0;
    for (int i = 0; i < matches_.rows(); ++i) {
      unsigned const flags = got.flags.at(static_cast<std::size_t>(matches_(i, 0)));
      bool const inlier = (flags & ft::two_view_flag::inlier) != 0;
      differing += static_cast<int>(inlier != (want(i) != 0));
    }
    r.add(differing <= 1, differing);
  }

  /// Good points of the four motions: their order depends on signs of the decomposition.
  void compare_counts(stage_result& r, two_view_answer const& got) const {
    auto const recorded = read<std::int32_t>("F_good").data;
    std::array<int, 4> want{};
    std::array<int, 4> have{};
    std::copy_n(recorded.begin(), 4, want.begin());
    std::copy_n(got.result.points_of, 4, have.begin());
    r.add(got.result.motions == 4);
    std::sort(want.begin(), want.end(), std::greater<>());
    std::sort(have.begin(), have.end(), std::greater<>());
    for (std::size_t k = 0; k < 4; ++k) {
      r.add(std::abs(want[k] - have[k]) <= (k == 0 ? 1 : 3), want[k] - have[k]);
    }
  }

  void compare_points(conformance_table& table, two_view_answer const& got) const {
    auto const T = read<float>("T21");
    auto& motion = table["two_view_motion"];
    auto const& m = got.result.T_21;
    float const t[3] = {m.t.x, m.t.y, m.t.z};
    double turned = 0;
    double moved = 0;
    for (int i = 0; i < 3; ++i) {
      for (int j = 0; j < 3; ++j) {
        turned = std::max(turned, std::abs(static_cast<double>(m.R.m[3 * i + j] - T(i, j))));
      }
      moved = std::max(moved, std::abs(static_cast<double>(t[i] - T(i, 3))));
    }
    motion.add(turned <= 1e-5, turned);
    motion.add(moved <= 1e-4, moved);

    auto& r = table["two_view_points"];
    auto const P = read<float>("P");
    auto const triangulated = read<std::uint8_t>("triangulated");
    int differing = 0;
    int missing = 0;
    for (int i = 0; i < P.rows(); ++i) {
      auto const at = static_cast<std::size_t>(i);
      auto const have = got.points.at(at).template cast<double>();
      ft::vec3<double> const want{static_cast<double>(P(i, 0)), static_cast<double>(P(i, 1)),
                                  static_cast<double>(P(i, 2))};
      unsigned const flags = got.flags.at(at);
      bool const near_ray = (flags & ft::two_view_flag::triangulated) == 0;
      differing += static_cast<int>(near_ray == (triangulated(i) != 0));
      double const size = std::sqrt(dot(want, want));
      bool const there = (flags & ft::two_view_flag::point) != 0;
      missing += static_cast<int>(there != (size > 0));
      if (!there || !(size > 0)) { continue; }
      double const d = std::sqrt(dot(have - want, have - want)) / size;
      r.add(d <= 1e-3, d);
    }
    r.add(differing <= 1, differing);
    r.add(missing <= 1, missing);
  }

  Exec exec_;
  std::string folder_;
  npy<float> p1_;
  npy<float> p2_;
  npy<std::int32_t> matches_;
};

/// @param folder of one case of two_view
template <typename Exec>
void compare_two_view(Exec const& exec, std::string const& folder, conformance_table& table) {
  golden_two_view<Exec>(exec, folder).run(table);
}

}  // namespace test
