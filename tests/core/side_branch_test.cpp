// SPDX-License-Identifier: Apache-2.0
// Branches: what is queued on one sees what was there at the fork, and is there after the join,
// queued or recorded. Launches beside the one ahead likewise.
#include "ft/core/side_branch.hpp"

#include <gtest/gtest.h>

#include <cstddef>
#include <vector>

#include "ft/core/execution.hpp"
#include "ft/core/memory.hpp"
#include "ft/core/recording.hpp"
#include "tests/support/backends.hpp"

namespace side_branch_test {

/// to = factor * from + term, element by element.
struct scale_and_add {
  using scratch = ft::no_scratch;
  template <typename Group>
  FT_HOST_DEVICE void operator()(Group, scratch&, int item, int factor, int const* from,
                                 int const* term, int* to) const {
    to[item] = factor * from[item] + term[item];
  }
};

template <typename Backend>
class side_branch_unit : public test::on_backend<Backend> {
protected:
  using exec_type = typename Backend::exec_type;
  using memory = ft::buffer<int, exec_type::space>;
  static constexpr int size = 100000;
  Backend backend;

  static void add(exec_type const& e, int factor, memory const& from, memory const& term,
                  memory const& to) {
    ft::for_each_item<ft::per_thread>(e, size, scale_and_add{}, factor,
                                      static_cast<int const*>(from.data()),
                                      static_cast<int const*>(term.data()), to.data());
  }

  /// 3 (2 input + input) + (5 (2 input + input) + input) by a branch beside the main line.
  /// @param fork of an executor
  template <typename Fork>
  void expect_sum(Fork const& fork, ft::side_branch<exec_type>& branch) {
    auto const& exec = backend.exec;
    std::vector<int> values;
    for (int i = 0; i < size; ++i) { values.push_back(i % 1009); }
    auto const input = test::to_exec(exec, values);
    constexpr auto count = static_cast<std::size_t>(size);
    memory const begun(count);
    memory const beside(count);
    memory const ahead(count);
    memory const joined(count);
    auto const queue = [&](exec_type const& e) {
      add(e, 2, input, input, begun);
      add(fork(e), 5, begun, input, beside);
      ft::fill_bytes(e, ahead.data(), 0, ahead.bytes());
      add(e, 3, begun, ahead, ahead);
      branch.join(e);
      add(e, 1, ahead, beside, joined);
    };
    auto const expect = [&] {
      auto const got = test::from_exec(exec, static_cast<int const*>(joined.data()), count);
      for (std::size_t i = 0; i < count; ++i) {
        int const v = values[i];
        ASSERT_EQ(got[i], 3 * (3 * v) + (5 * (3 * v) + v)) << i;
      }
      ft::fill_bytes(exec, begun.data(), 0, begun.bytes());
      ft::fill_bytes(exec, beside.data(), 0, beside.bytes());
      ft::fill_bytes(exec, joined.data(), 0, joined.bytes());
    };
    queue(exec);
    expect();
    ft::recording<exec_type> recorded;
    exec.wait();
    recorded.record(exec, queue);
    for (int i = 0; i < 3; ++i) {
      recorded.replay(exec, queue);
      expect();
    }
    exec.wait();
  }
};
TYPED_TEST_SUITE(side_branch_unit, test::backends);

TYPED_TEST(side_branch_unit, what_is_forked_is_there_after_the_join) {
  ft::side_branch<typename TestFixture::exec_type> branch;
  branch.make();
  this->expect_sum([&](auto const& e) { return branch.fork(e); }, branch);
}

TYPED_TEST(side_branch_unit, launches_beside_the_one_ahead_find_what_that_waited_for) {
  using executor = typename TypeParam::exec_type;
  auto const& exec = this->backend.exec;
  constexpr int length = TestFixture::size;
  constexpr auto count = static_cast<std::size_t>(length);
  using buffer = typename TestFixture::memory;
  ft::buffer<int, ft::staging_space<executor>> input(count);
  buffer const values(count);
  buffer const begun(count);
  buffer const ahead(count);
  buffer const first(count);
  buffer const second(count);
  buffer const half(count);
  buffer const joined(count);
  auto const add = TestFixture::add;
  // 3 v; 9 v + v; beside it 15 v + v and 21 v + v; all that the last launches waited for.
  auto const queue = [&](executor const& e) {
    ft::copy(e, values.data(), static_cast<int const*>(input.data()), count);
    add(e, 2, values, values, begun);
    add(e, 3, begun, values, ahead);
    add(ft::beside(e), 5, begun, values, first);
    add(ft::beside(e), 7, begun, values, second);
    add(ft::in_turn(ft::beside(e)), 1, ahead, first, half);
    add(e, 1, half, second, joined);
  };
  ft::recording<executor> recorded;
  recorded.record(exec, queue);
  for (int round = 0; round < 20; ++round) {
    for (int i = 0; i < length; ++i) { input.data()[i] = (i * 7 + round * 1000) % 100003; }
    for (buffer const* m : {&begun, &ahead, &first, &second, &half, &joined}) {
      ft::fill_bytes(exec, m->data(), 0x5a, m->bytes());
    }
    if (round % 4 == 0) {
      queue(exec);
    } else {
      recorded.replay(exec, queue);
    }
    auto const got = test::from_exec(exec, static_cast<int const*>(joined.data()), count);
    for (std::size_t i = 0; i < count; ++i) {
      ASSERT_EQ(got[i], (10 + 16 + 22) * input.data()[i]) << i << " in round " << round;
    }
  }
}

#if defined(__CUDACC__)
TEST(launches, that_go_evenly_are_not_early_and_stay_in_their_stream) {
  if (!test::cuda_backend::available()) { GTEST_SKIP() << "no CUDA device"; }
  test::cuda_backend const backend;
  ft::cuda_exec const early(backend.exec.stream, true);
  EXPECT_FALSE(ft::evenly(early).early_launches);
  EXPECT_EQ(ft::evenly(early).stream, early.stream);
  EXPECT_FALSE(early.launches_beside);
  EXPECT_TRUE(ft::beside(early).launches_beside);
  EXPECT_EQ(ft::beside(early).stream, early.stream);
  EXPECT_FALSE(ft::in_turn(ft::beside(early)).launches_beside);
  EXPECT_TRUE(ft::in_turn(ft::beside(early)).early_launches);
  EXPECT_FALSE(ft::evenly(ft::beside(early)).launches_beside);
  EXPECT_FALSE(ft::beside(ft::cuda_exec(early.stream)).launches_beside) << "not early";
  ft::side_branch<ft::cuda_exec> branch;
  branch.make();
  auto const forked = branch.fork(early);
  EXPECT_TRUE(forked.early_launches);
  EXPECT_NE(forked.stream, early.stream);
  branch.join(early);
  early.wait();
}
#endif

}  // namespace side_branch_test
