// SPDX-License-Identifier: Apache-2.0
// The cost of centres by an accelerometer, against a dense elimination of all velocities and errors
// of the acceleration; the same bits on both executors.
#include "ft/kernels/odometry/chain_centres.hpp"

#include <gtest/gtest.h>

#include <cmath>
#include <cstring>
#include <random>
#include <vector>

#include "ft/core/execution.hpp"
#include "tests/support/backends.hpp"
#include "tests/support/example_rigs.hpp"
#include "tests/support/plain_map.hpp"

namespace chain_centres_test {

constexpr int capacity = 14;
constexpr double accel_sigma = 0.1;

/// Item: a problem.
struct build_chain {
  using scratch = ft::detail::chain_scratch;
  template <typename Group>
  FT_HOST_DEVICE void operator()(Group g, scratch& s, int b, ft::window_problem_view const& problem,
                                 ft::detail::chain_step const* steps) const {
    for (int v = g.rank(); v < problem.view_count[b]; v += g.size()) {
      s.steps[v] = steps[problem.view(b, v)];
      if (v == 0) { s.first_arm = s.steps[v].arm; }
    }
    g.sync();
    ft::detail::centre_chain<Group>(g, s, problem, b).build(accel_sigma);
  }
};

struct arrays {
  ft::window_problem_view problem;
  ft::detail::chain_step* steps = nullptr;
};

/// Problems of 1 to `capacity` views; every fifth step or so is missing.
template <typename Exec>
struct chains {
  static constexpr int batch = capacity;
  Exec const& exec;
  test::mirrored<Exec, arrays> data;

  chains(Exec const& on, unsigned seed)
      : exec(on), data([](ft::carver& c, arrays& a) {
          carve(c, a.problem, {capacity, 1, 1, true}, batch);
          a.steps = c.take<ft::detail::chain_step>(batch * capacity);
        }) {
    std::mt19937 random(seed);
    std::uniform_real_distribution<double> of(-1, 1);
    auto const any = [&] { return ft::vec3<double>{of(random), of(random), of(random)}; };
    for (int b = 0; b < batch; ++b) {
      data.host.problem.view_count[b] = b + 1;
      for (int v = 0; v <= b; ++v) {
        data.host.problem.T_cw[data.host.problem.view(b, v)] = test::turn(any(), any());
        double const T = random() % 5 == 0 ? 0.0 : 0.15 + 0.1 * of(random);
        double const vv = 1e-6 * (2 + of(random)), pp = 1e-5 * (2 + of(random));
        data.host.steps[data.host.problem.view(b, v)] = {
            any(), any(),
            any(), T,
            pp,    0.9 * of(random) * std::sqrt(pp * vv),
            vv,    1e-4 * (2 + of(random))};
      }
    }
    data.push(exec);
    ft::for_each_item<ft::per_block<64>>(
        exec, batch, build_chain{}, data.device.problem,
        static_cast<ft::detail::chain_step const*>(data.device.steps));
    data.pull(exec);
  }
  std::vector<double> information(int b) const {
    double const* const from =
        data.host.problem.centre_information + data.host.problem.view(b, 0) * capacity;
    return {from, from + (b + 1) * capacity};
  }
};

/// Information of the positions, [views * views]: everything is written into one dense matrix of
/// positions, velocities and errors, and the latter two are eliminated, the best told first.
/// Velocities that nothing tells are left out.
inline std::vector<double> oracle(ft::detail::chain_step const* steps, int views) {
  int const n = 3 * views;
  std::vector<double> all(static_cast<std::size_t>(n * n));
  auto const entry = [&](int i, int j) -> double& {
    return all[static_cast<std::size_t>(i * n + j)];
  };
  auto const at = [&](int v, int what) { return what * views + v; };  // p, v, a
  for (int k = 0; k < views; ++k) {
    auto const& s = steps[k];
    if (k == 0 || !(s.T > 0)) {
      entry(at(k, 2), at(k, 2)) += 1 / (accel_sigma * accel_sigma);
      continue;
    }
    int const columns[6] = {at(k, 0), at(k, 1), at(k, 2), at(k - 1, 0), at(k - 1, 1), at(k - 1, 2)};
    double const rows[3][6] = {
        {1, 0, 0, -1, -s.T, -s.T * s.T / 2}, {0, 1, 0, 0, -1, -s.T}, {0, 0, 1, 0, 0, -1}};
    double const determinant = s.pp * s.vv - s.pv * s.pv;
    double const weights[3][3] = {{s.vv / determinant, -s.pv / determinant, 0},
                                  {-s.pv / determinant, s.pp / determinant, 0},
                                  {0, 0, 1 / s.aa}};
    for (int i = 0; i < 36; ++i) {
      for (int j = 0; j < 9; ++j) {
        entry(columns[i / 6], columns[i % 6]) +=
            rows[j / 3][i / 6] * weights[j / 3][j % 3] * rows[j % 3][i % 6];
      }
    }
  }
  std::vector<double> told(static_cast<std::size_t>(n));
  for (int i = 0; i < n; ++i) { told[static_cast<std::size_t>(i)] = entry(i, i); }
  std::vector<bool> gone(static_cast<std::size_t>(n));
  for (;;) {
    int best = -1;
    for (int i = views; i < n; ++i) {
      bool const known = entry(i, i) > 1e-11 * told[static_cast<std::size_t>(i)];
      if (!gone[static_cast<std::size_t>(i)] && known &&
          (best < 0 || entry(i, i) > entry(best, best))) {
        best = i;
      }
    }
    if (best < 0) { break; }
    gone[static_cast<std::size_t>(best)] = true;
    for (int i = 0; i < n; ++i) {
      double const factor = entry(i, best) / entry(best, best);
      for (int j = 0; i != best && j < n; ++j) { entry(i, j) -= factor * entry(best, j); }
    }
    for (int i = 0; i < n; ++i) {
      if (i != best) { entry(best, i) = entry(i, best) = 0; }
    }
  }
  std::vector<double> positions;
  for (int i = 0; i < views * views; ++i) { positions.push_back(entry(i / views, i % views)); }
  return positions;
}

template <typename Backend>
class ChainCentres : public test::on_backend<Backend> {};
TYPED_TEST_SUITE(ChainCentres, test::backends);

TYPED_TEST(ChainCentres, IsADenseElimination) {
  TypeParam backend;
  for (unsigned seed = 1; seed < 4; ++seed) {
    chains<typename TypeParam::exec_type> const c(backend.exec, seed);
    for (int b = 0; b < c.batch; ++b) {
      auto const want = oracle(c.data.host.steps + c.data.host.problem.view(b, 0), b + 1);
      auto const got = c.information(b);
      double const scale = 1e5;  // the information of one step
      for (int i = 0; i <= b; ++i) {
        for (int j = 0; j <= b; ++j) {
          EXPECT_NEAR(got[static_cast<std::size_t>(i * capacity + j)] / scale,
                      want[static_cast<std::size_t>(i * (b + 1) + j)] / scale, 1e-9)
              << seed << ' ' << b << ' ' << i << ' ' << j;
        }
      }
    }
  }
}

TYPED_TEST(ChainCentres, ExecutorsAgreeToTheBit) {
  TypeParam backend;
  ft::host_exec const host(1);
  for (unsigned seed = 10; seed < 15; ++seed) {
    chains<ft::host_exec> const want(host, seed);
    chains<typename TypeParam::exec_type> const got(backend.exec, seed);
    for (int b = 0; b < want.batch; ++b) {
      auto const x = want.information(b), y = got.information(b);
      for (int i = 0; i <= b; ++i) {
        auto const row = static_cast<std::size_t>(i * capacity);
        EXPECT_EQ(std::memcmp(&x[row], &y[row], sizeof(double) * static_cast<std::size_t>(b + 1)),
                  0)
            << seed << ' ' << b << ' ' << i;
      }
    }
  }
}

}  // namespace chain_centres_test
