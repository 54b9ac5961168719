// SPDX-License-Identifier: Apache-2.0
/// @file The steps of a pose graph's optimisation on an executor, and their memory.
#pragma once

#include <cstddef>
#include <utility>
#include <vector>

#include "ft/containers/pose_graph.hpp"
#include "ft/core/config.hpp"
#include "ft/core/execution.hpp"
#include "ft/core/memory.hpp"
#include "ft/core/ordered_sum.hpp"
#include "ft/kernels/graph/chordal_start.hpp"
#include "ft/kernels/graph/dense_elimination.hpp"
#include "ft/kernels/graph/edges.hpp"
#include "ft/kernels/graph/elimination_order.hpp"
#include "ft/kernels/graph/sparse_elimination.hpp"
#include "ft/kernels/graph/system.hpp"
#include "ft/types/poses.hpp"

namespace ft {
inline namespace FT_ABI {
namespace detail {

/// What is known of poses.
struct graph_verdict {
  double cost;      ///< robust
  double chi2;      ///< without kernels
  double promised;  ///< by how much the linear system says that the step lowers the cost
};

/// One item: the verdict about a trial.
struct judge_step {
  using sums = ordered_sum_scratch<2, double>;
  struct scratch {
    sums costs;
    ordered_sum_scratch<1, double> promise;
  };
  int edges;
  int unknowns;  ///< 0: poses that were not made by a step
  double damping;

  template <typename Group, int N>
  FT_HOST_DEVICE void operator()(Group g, scratch& s, int, graph_system_view<N> const& A,
                                 double const* cost, graph_verdict* verdict) const {
    ordered_sum(g, s.costs, edges, [&](int e, sum_terms<2, double>& acc) {
      acc.of[0] += cost[2 * e];
      acc.of[1] += cost[2 * e + 1];
    });
    ordered_sum(g, s.promise, unknowns, [&](int k, sum_terms<1, double>& acc) {
      real64 const x = A.solution[k];
      acc.of[0] += (x * (A.gradient[k] + real64(damping) * A.diagonal[k] * x)).value;
    });
    if (g.rank() == 0) {
      *verdict = {s.costs.total.of[0], s.costs.total.of[1], s.promise.total.of[0]};
    }
  }
};

/// A graph's system and poses in executor memory. Functions enqueue, but for those that return
/// something: they wait.
template <typename Exec, typename Motion>
class pose_graph_solver {
public:
  static constexpr int freedom = freedom_of<Motion>;
  using graph_type = motion_graph<Motion>;
  using edge = motion_edge<Motion>;
  using system_view = graph_system_view<freedom>;

  /// Allocates. `graph` and `order` must outlive the solver.
  pose_graph_solver(Exec const& exec, graph_type const& graph, elimination_order const& order,
                    heading_axis const& heading)
      : exec_(exec),
        order_(order),
        heading_(heading),
        edges_(static_cast<int>(graph.edges.size())),
        memory_([&](carver& c, memory& m) { lay_out(c, m, graph, order); }) {
    upload_plan();
    copy(exec_, memory_->edges, graph.edges.data(), graph.edges.size());
    set_poses(graph.T_world_pose);
    system_view const& A = memory_->system;
    auto const side = static_cast<std::size_t>(A.side());
    fill_bytes(exec_, A.dense, 0, side * side * sizeof(double));
    fill_bytes(exec_, A.dense_right(), 0, side * sizeof(double));
    exec_.wait();
  }

  std::size_t bytes() const { return memory_.bytes(); }
  void set_poses(std::vector<Motion> const& T) {
    for (int k = 0; k < 2; ++k) { copy(exec_, memory_->T[k], T.data(), T.size()); }
    exec_.wait();
  }
  void download(std::vector<Motion>& T) const {
    copy(exec_, T.data(), memory_->T[current_], T.size());
    exec_.wait();
  }

  /// Cost of the current poses.
  graph_verdict measure() { return judge(current_, 0, 0); }
  /// Normal equations at the current poses.
  void linearize() { add_terms(linearize_edge<freedom>{heading_}); }
  /// Solves them, and measures the poses that the step leads to.
  graph_verdict try_step(double damping) {
    solve(damping);
    memory const& m = memory_.view();
    for_each_item<per_thread>(exec_, order_.positions(), move_pose{heading_}, m.system,
                              static_cast<Motion const*>(m.T[current_]), m.T[1 - current_]);
    return judge(1 - current_, freedom * order_.positions(), damping);
  }
  /// Makes the poses that were tried the current ones.
  void accept() { current_ = 1 - current_; }

  /// Rotations, scales and translations by linear least squares.
  void start_chordal() {
    memory const& m = memory_.view();
    int const n = order_.positions();
    Motion* const T = m.T[current_];
    Motion* const other = m.T[1 - current_];
    for_each_item<per_thread>(exec_, n, clear_rotation{}, m.system, T);
    add_terms(chordal_rotation{{0, 1}});
    solve(least_damping);
    for_each_item<per_thread>(exec_, n, take_rows{{0, 1}, 2}, m.system, other);
    add_terms(chordal_rotation{{2, 0}});
    solve(least_damping);
    for_each_item<per_thread>(exec_, n, take_rows{{2, 0}, 1}, m.system, other);
    for_each_item<per_thread>(exec_, n, project_rotation{}, m.system, other);
    accept();
    if constexpr (freedom == 7) {
      add_terms(chordal_scale{});
      solve(least_damping);
      for_each_item<per_thread>(exec_, n, scale_pose{}, m.system, other);
    }
    add_terms(chordal_translation{});
    solve(least_damping);
    for_each_item<per_thread>(exec_, n, shift_pose{}, m.system, other);
  }

private:
  /// Of linear problems, so that rounding does not make a pivot negative.
  static constexpr double least_damping = 1e-14;

  struct memory {
    system_view system;
    edge* edges = nullptr;
    Motion* T[2] = {nullptr, nullptr};
    double* cost = nullptr;  ///< [edges][2]
    graph_verdict* verdict = nullptr;
    int* numbers = nullptr;  ///< of the plan
  };

  /// Calls take(array of the order, pointer of the view) for each array.
  template <typename Take>
  static void for_each_array(elimination_order const& order, graph_plan_view& plan,
                             Take const& take) {
    take(order.column_begin, plan.column_begin);
    take(order.block_row, plan.block_row);
    take(order.block_column, plan.block_column);
    take(order.row_begin, plan.row_begin);
    take(order.row_column, plan.row_column);
    take(order.row_block, plan.row_block);
    take(order.term_begin, plan.term_begin);
    take(order.term, plan.term);
    take(order.pose, plan.pose);
  }

  static void lay_out(carver& c, memory& m, graph_type const& graph,
                      elimination_order const& order) {
    system_view& A = m.system;
    A.plan.columns = order.columns();
    A.plan.dense = order.dense;
    A.plan.sparse_blocks = order.sparse_blocks();
    A.plan.blocks = order.blocks();
    std::size_t numbers = 0;
    for_each_array(order, A.plan,
                   [&](std::vector<int> const& from, int const*&) { numbers += from.size(); });
    m.numbers = c.take<int>(numbers);
    int const* next = m.numbers;
    for_each_array(order, A.plan, [&](std::vector<int> const& from, int const*& to) {
      to = next;
      if (next != nullptr) { next += from.size(); }
    });
    std::size_t const edges = graph.edges.size();
    m.edges = c.take<edge>(edges);
    for (auto& T : m.T) { T = c.take<Motion>(graph.T_world_pose.size()); }
    m.cost = c.take<double>(2 * edges);
    m.verdict = c.take<graph_verdict>(1);
    auto const side = static_cast<std::size_t>(A.side());
    std::size_t const unknowns = freedom * static_cast<std::size_t>(order.columns()) + side;
    constexpr std::size_t block = freedom * freedom;
    A.edge_term = c.take<double>(checked_mul(edges, edge_terms<freedom>));
    A.value = c.take<double>(checked_mul(static_cast<std::size_t>(order.sparse_blocks()), block));
    A.pivot = c.take<double>(block * static_cast<std::size_t>(order.columns()));
    A.dense = c.take<double>(checked_mul(side, side));
    A.dense_factor = c.take<double>(side * tile_side<freedom>);
    A.right = c.take<double>(unknowns);
    A.solution = c.take<double>(unknowns);
    A.gradient = c.take<double>(unknowns);
    A.diagonal = c.take<double>(unknowns);
  }

  void upload_plan() {
    std::vector<int> numbers;
    graph_plan_view plan;
    for_each_array(order_, plan, [&](std::vector<int> const& from, int const*&) {
      numbers.insert(numbers.end(), from.begin(), from.end());
    });
    copy(exec_, memory_->numbers, numbers.data(), numbers.size());
    exec_.wait();
  }

  template <typename Op>
  void add_terms(Op const& op) {
    memory const& m = memory_.view();
    for_each_item<per_warp>(exec_, edges_, op, static_cast<edge const*>(m.edges),
                            static_cast<Motion const*>(m.T[current_]), m.system.edge_term);
  }

  graph_verdict judge(int at, int unknowns, double damping) {
    memory const& m = memory_.view();
    for_each_item<per_thread>(exec_, edges_, measure_edge{}, static_cast<edge const*>(m.edges),
                              static_cast<Motion const*>(m.T[at]), m.cost);
    for_each_item<per_block<sum_lanes>>(exec_, 1, judge_step{edges_, unknowns, damping}, m.system,
                                        static_cast<double const*>(m.cost), m.verdict);
    graph_verdict verdict{};
    copy(exec_, &verdict, m.verdict, 1);
    exec_.wait();
    return verdict;
  }

  void solve(double damping) {
    system_view const& A = memory_->system;
    auto const at = [](std::vector<int> const& list, int k) {
      return list[static_cast<std::size_t>(k)];
    };
    for (int r = 0; r < order_.rounds(); ++r) {
      int const begin = at(order_.round_begin, r);
      int const end = at(order_.round_begin, r + 1);
      int const first = at(order_.column_begin, begin);
      int const blocks = at(order_.column_begin, end) - first;
      int const items = blocks + end - begin;
      for_each_item<per_warp>(exec_, items, reduce_blocks{first, blocks, begin, damping}, A);
      for_each_item<per_warp>(exec_, items, divide_blocks{first, blocks, begin}, A);
    }
    solve_dense(damping);
    for (int r = order_.rounds() - 1; r >= 0; --r) {
      int const begin = at(order_.round_begin, r);
      for_each_item<per_warp>(exec_, at(order_.round_begin, r + 1) - begin,
                              substitute_column{begin}, A);
    }
  }

  void solve_dense(double damping) {
    system_view const& A = memory_->system;
    if (order_.dense == 0) { return; }
    int const blocks = A.plan.blocks - A.plan.sparse_blocks;
    for_each_item<per_warp>(exec_, static_cast<int>(A.side()) - freedom * order_.dense, pad_dense{},
                            A);
    for_each_item<per_warp>(exec_, blocks + order_.dense,
                            reduce_blocks{A.plan.sparse_blocks, blocks, A.plan.columns, damping},
                            A);
    int const tiles = A.tiles();
    for (int step = 0; step < tiles; ++step) {
      int const below = tiles - 1 - step;
      for_each_item<per_block<tile_threads>>(exec_, below + 1, factor_tiles{step}, A);
      for_each_item<per_block<tile_threads>>(exec_, below * (below + 1) / 2, update_tiles{step}, A);
    }
    for_each_item<per_block<2 * tile_threads>>(exec_, 1, substitute_dense{}, A);
  }

  Exec exec_;
  elimination_order const& order_;
  heading_axis heading_;
  int edges_;
  int current_ = 0;
  owner<memory, Exec::space> memory_;
};

}  // namespace detail
}  // namespace FT_ABI
}  // namespace ft
