// SPDX-License-Identifier: Apache-2.0
/// @file The matching runner, instantiated once per executor: descriptors, all with all.
#pragma once

#include <cmath>
#include <cstddef>
#include <cstdint>
#include <memory>
#include <stdexcept>
#include <string>
#include <type_traits>
#include <vector>

#include "bench/camera_runner.hpp"
#include "bench/owned_executor.hpp"
#include "bench/runner.hpp"
#include "ft/core/execution.hpp"
#include "ft/core/memory.hpp"
#include "ft/core/recording.hpp"
#include "ft/descriptors/binary_descriptor.hpp"
#include "ft/descriptors/vector_descriptor.hpp"
#include "ft/kernels/matching/match_descriptors.hpp"

namespace bench {
inline namespace FT_ABI {

/// Random rows; those of other `noise` with the same number are alike.
template <int Bits>
void draw_row(ft::binary_descriptor<Bits>& row, std::uint64_t number, std::uint64_t noise) {
  for (std::size_t i = 0; i < Bits; ++i) {
    bool const flipped = uniform(number, 2 * i + 1000003 * noise) < 0.05;
    auto const bit = static_cast<std::uint32_t>((uniform(number, 2 * i + 1) < 0.5) != flipped);
    row.words[i / 32] = (i % 32 == 0 ? 0 : row.words[i / 32]) | bit << i % 32;
  }
}
template <typename T, int N, typename Metric>
void draw_row(ft::vector_descriptor<T, N, Metric>& row, std::uint64_t number, std::uint64_t noise) {
  double of[N];
  double squares = 0;
  for (std::size_t i = 0; i < N; ++i) {
    of[i] =
        uniform(number, 2 * i + 1) - 0.5 + 0.1 * (uniform(number, 2 * i + 1000003 * noise) - 0.5);
    squares += of[i] * of[i];
  }
  for (std::size_t i = 0; i < N; ++i) {
    double const v = of[i] / std::sqrt(squares);
    if constexpr (std::is_same<T, std::int8_t>::value) {
      row.of[i] = static_cast<std::int8_t>(std::lround(127 * v));
    } else if constexpr (std::is_same<T, float>::value) {
      row.of[i] = static_cast<float>(v);
    } else {
      row.of[i] = ft::float16::nearest(static_cast<float>(v));
    }
  }
}

/// As many query rows as train rows, of which every second one is alike one of the others.
template <typename Exec, typename D>
class matching_runner_of final : public matching_runner {
public:
  explicit matching_runner_of(matching_case const& what)
      : owned_(what.host_threads),
        rows_(what.rows),
        mutual_(what.mutual),
        query_(count()),
        train_(count()),
        out_(count()),
        work_([&](ft::carver& c, workspace& v) { carve(c, v, rows_, rows_); }) {
    std::vector<D> query(count()), train(count());
    for (std::size_t i = 0; i < count(); ++i) {
      draw_row(train[i], i, 1);
      draw_row(query[i], i % 2 == 0 ? (i * 7) % count() : i + count(), 2);
    }
    ft::copy(owned_.exec, query_.data(), static_cast<D const*>(query.data()), count());
    ft::copy(owned_.exec, train_.data(), static_cast<D const*>(train.data()), count());
    owned_.exec.wait();
    graph_.record(owned_.exec, [&](auto const& exec) { queue(exec); });
  }

  double run() override {
    time_.begin(owned_.exec);
    graph_.replay(owned_.exec, [&](auto const& exec) { queue(exec); });
    return time_.end(owned_.exec);
  }
  double matched_share() override {
    std::vector<match> found(count());
    ft::copy(owned_.exec, found.data(), static_cast<match const*>(out_.data()), count());
    owned_.exec.wait();
    std::size_t accepted = 0;
    for (match const& m : found) { accepted += m.index >= 0 ? 1 : 0; }
    return static_cast<double>(accepted) / static_cast<double>(count());
  }

private:
  using distance_type = ft::descriptor_distance<D>;
  using match = ft::descriptor_match<distance_type>;
  using workspace = ft::match_workspace<distance_type>;

  std::size_t count() const { return static_cast<std::size_t>(rows_); }
  template <typename E>
  void queue(E const& exec) const {
    auto const tests = ft::match_tests<distance_type>::by(D::rules, mutual_);
    ft::match_descriptors(exec, ft::descriptor_rows<D>{query_.data(), rows_},
                          ft::descriptor_rows<D>{train_.data(), rows_}, tests, work_.view(),
                          out_.data());
  }

  owned_executor<Exec> owned_;
  int rows_;
  bool mutual_;
  ft::buffer<D, Exec::space> query_, train_;
  ft::buffer<match, Exec::space> out_;
  ft::owner<workspace, Exec::space> work_;
  ft::recording<Exec> graph_;
  interval<Exec> time_;
};

template <typename Exec>
std::unique_ptr<matching_runner> make_matching(matching_case const& what) {
  using make = std::unique_ptr<matching_runner> (*)(matching_case const&);
  auto const of = [](auto row) -> make {
    return [](matching_case const& c) -> std::unique_ptr<matching_runner> {
      return std::make_unique<matching_runner_of<Exec, decltype(row)>>(c);
    };
  };
  make const makers[] = {of(ft::binary_descriptor<128>{}),
                         of(ft::binary_descriptor<256>{}),
                         of(ft::binary_descriptor<488>{}),
                         of(ft::binary_descriptor<512>{}),
                         of(ft::vector_descriptor<std::int8_t, 128>{}),
                         of(ft::vector_descriptor<ft::float16, 128>{}),
                         of(ft::vector_descriptor<float, 64>{}),
                         of(ft::vector_descriptor<float, 128>{})};
  static_assert(sizeof makers / sizeof makers[0] == sizeof matching_models / sizeof(char const*),
                "a maker for each model");
  for (std::size_t i = 0; i < sizeof makers / sizeof makers[0]; ++i) {
    if (what.model == matching_models[i]) { return makers[i](what); }
  }
  throw std::runtime_error("no such descriptor: " + what.model);
}

}  // namespace FT_ABI

std::unique_ptr<matching_runner> make_host_matching(matching_case const& what);
std::unique_ptr<matching_runner> make_cuda_matching(matching_case const& what);

}  // namespace bench
