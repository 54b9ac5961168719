// SPDX-License-Identifier: Apache-2.0
// Branches: what is queued on one sees what was there at the fork, and is there after the join,
// queued or recorded. Concurrent launches likewise. What a host waits for.
#include "ft/core/recording.hpp"

#include <gtest/gtest.h>

#include <algorithm>
#include <cstddef>
#include <vector>

#include "ft/core/atomics.hpp"
#include "ft/core/execution.hpp"
#include "ft/core/memory.hpp"
#include "tests/support/backends.hpp"

namespace side_branch_test {

using order = ft::detail::launch_order;

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
    ft::for_each_item<ft::per_thread>(e, size, scale_and_add{}, factor, from.data(), term.data(),
                                      to.data());
  }

  /// 3 (2 input + input) + (5 (2 input + input) + input) by a branch concurrent with the main line.
  /// @param fork of an executor
  template <typename Fork>
  void expect_sum(Fork const& fork, ft::side_branch<exec_type>& branch) {
    auto const& exec = backend.exec;
    std::vector<int> values;
    for (int i = 0; i < size; ++i) { values.push_back(i % 1009); }
    auto const input = test::to_exec(exec, values);
    constexpr auto count = static_cast<std::size_t>(size);
    memory const begun(count);
    memory const branched(count);
    memory const ahead(count);
    memory const joined(count);
    auto const queue = [&](exec_type const& e) {
      add(e, 2, input, input, begun);
      add(fork(e), 5, begun, input, branched);
      ft::fill_bytes(e, ahead.data(), 0, ahead.bytes());
      add(e, 3, begun, ahead, ahead);
      branch.join(e);
      add(e, 1, ahead, branched, joined);
    };
    auto const expect = [&] {
      auto const got = test::from_exec(exec, joined.data(), count);
      for (std::size_t i = 0; i < count; ++i) {
        int const v = values[i];
        ASSERT_EQ(got[i], 3 * (3 * v) + (5 * (3 * v) + v)) << i;
      }
      ft::fill_bytes(exec, begun.data(), 0, begun.bytes());
      ft::fill_bytes(exec, branched.data(), 0, branched.bytes());
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

TYPED_TEST(side_branch_unit, a_second_fork_waits_for_the_main_line_again) {
  using executor = typename TypeParam::exec_type;
  using buffer = typename TestFixture::memory;
  auto const& exec = this->backend.exec;
  constexpr auto count = static_cast<std::size_t>(TestFixture::size);
  std::vector<int> values;
  for (int i = 0; i < TestFixture::size; ++i) { values.push_back(i % 1009); }
  auto const input = test::to_exec(exec, values);
  buffer const first(count);
  buffer const ahead(count);
  buffer const second(count);
  buffer const beside(count);
  buffer const joined(count);
  ft::side_branch<executor> branch;
  branch.make();
  auto const add = TestFixture::add;
  // 3 v on the branch; 4 v, then 5 (4 v) + 3 v on the branch, beside 7 (4 v) + v.
  auto const queue = [&](executor const& e) {
    add(branch.fork(e), 2, input, input, first);
    add(e, 3, input, input, ahead);
    add(branch.fork(e), 5, ahead, first, second);
    add(e, 7, ahead, input, beside);
    branch.join(e);
    add(e, 1, second, beside, joined);
  };
  ft::recording<executor> recorded;
  recorded.record(exec, queue);
  for (int round = 0; round < 4; ++round) {
    for (buffer const* m : {&first, &ahead, &second, &beside, &joined}) {
      ft::fill_bytes(exec, m->data(), 0x5a, m->bytes());
    }
    if (round == 0) {
      queue(exec);
    } else {
      recorded.replay(exec, queue);
    }
    auto const got = test::from_exec(exec, joined.data(), count);
    for (std::size_t i = 0; i < count; ++i) {
      ASSERT_EQ(got[i], (5 * 4 + 3 + 7 * 4 + 1) * values[i]) << i << " in round " << round;
    }
  }
}

/// Writes a value to memory of the host, by all threads, and then the flag.
struct tell_host {
  using scratch = ft::no_scratch;
  template <typename Group>
  FT_HOST_DEVICE void operator()(Group g, scratch&, int, int const* value, int n, int* told,
                                 int* flag) const {
    for (int i = g.rank(); i < n; i += g.size()) { told[i] = *value; }
    g.sync();
    if (g.rank() == 0) { ft::set_flag(flag); }
  }
};

TYPED_TEST(side_branch_unit, the_host_sees_what_was_written_before_a_flag_and_at_a_mark) {
  using executor = typename TypeParam::exec_type;
  using staged = ft::buffer<int, ft::staging_space<executor>>;
  auto const& exec = this->backend.exec;
  constexpr int n = 300;
  staged const value(1), told(n), later(n), flags(2);
  typename TestFixture::memory const work(static_cast<std::size_t>(TestFixture::size));
  ft::work_mark<executor> end;
  end.wait();  // nothing was marked
  end.make();
  auto const queue = [&](executor const& e) {
    auto const tell = [&](staged const& to, int* flag) {
      ft::for_each_item<ft::per_warp>(e, 1, tell_host{}, value.data(), int{n}, to.data(), flag);
    };
    TestFixture::add(e, 1, work, work, work);
    tell(told, flags.data());
    for (int i = 0; i < 20; ++i) { TestFixture::add(e, 1, work, work, work); }
    tell(later, flags.data() + 1);
  };
  ft::fill_bytes(exec, work.data(), 0, work.bytes());
  exec.wait();
  ft::recording<executor> recorded;
  recorded.record(exec, queue);
  for (int round = 1; round <= 50; ++round) {
    *value.data() = round;
    flags.data()[0] = flags.data()[1] = 0;
    recorded.replay(exec, queue);
    end.set(exec);
    exec.wait_until([&] { return ft::is_set(flags.data()); });
    ASSERT_EQ(std::count(told.data(), told.data() + n, round), n) << round;
    end.make_wait(exec);
    end.wait();
    ASSERT_TRUE(ft::is_set(flags.data() + 1)) << round;
    ASSERT_EQ(std::count(later.data(), later.data() + n, round), n) << round;
  }
  flags.data()[0] = 0;
  exec.wait_until([] { return false; });  // all work is complete
}

TYPED_TEST(side_branch_unit, concurrent_launches_find_what_the_preceding_grid_waited_for) {
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
  buffer const halved(count);
  buffer const joined(count);
  auto const add = TestFixture::add;
  // 3 v; 9 v + v; concurrently 15 v + v and 21 v + v; all that the last launches waited for.
  auto const queue = [&](executor const& e) {
    ft::copy(e, values.data(), input.data(), count);
    add(e, 2, values, values, begun);
    add(e, 3, begun, values, ahead);
    auto const concurrent = ft::detail::with_order(e, order::concurrent);
    add(concurrent, 5, begun, values, first);
    add(concurrent, 7, begun, values, second);
    add(ft::detail::with_order(concurrent, order::serial), 1, ahead, first, halved);
    add(e, 1, halved, second, joined);
  };
  ft::recording<executor> recorded;
  recorded.record(exec, queue);
  for (int round = 0; round < 20; ++round) {
    for (int i = 0; i < length; ++i) { input.data()[i] = (i * 7 + round * 1000) % 100003; }
    for (buffer const* m : {&begun, &ahead, &first, &second, &halved, &joined}) {
      ft::fill_bytes(exec, m->data(), 0x5a, m->bytes());
    }
    if (round % 4 == 0) {
      queue(exec);
    } else {
      recorded.replay(exec, queue);
    }
    auto const got = test::from_exec(exec, joined.data(), count);
    for (std::size_t i = 0; i < count; ++i) {
      ASSERT_EQ(got[i], (10 + 16 + 22) * input.data()[i]) << i << " in round " << round;
    }
  }
}

#if defined(__CUDACC__)
TEST(launches, have_an_order_that_changes_neither_stream_nor_mode) {
  if (!test::cuda_backend::available()) { GTEST_SKIP() << "no CUDA device"; }
  test::cuda_backend const backend;
  using access = ft::detail::launch_access;
  EXPECT_FALSE(access::programmatic(backend.exec));
  EXPECT_EQ(access::order(backend.exec), order::serial);
  auto const recorded = access::make(backend.exec.stream, true);
  for (order const o : {order::serial, order::concurrent, order::full_wave}) {
    auto const ordered = ft::detail::with_order(recorded, o);
    EXPECT_EQ(access::order(ordered), o);
    EXPECT_TRUE(access::programmatic(ordered));
    EXPECT_EQ(ordered.stream, recorded.stream);
    EXPECT_EQ(access::order(ft::detail::with_order(ordered, order::serial)), order::serial);
    EXPECT_FALSE(access::programmatic(ft::detail::with_order(backend.exec, o)));
  }
  ft::side_branch<ft::cuda_exec> branch;
  branch.make();
  auto const forked = branch.fork(ft::detail::with_order(recorded, order::concurrent));
  EXPECT_TRUE(access::programmatic(forked));
  EXPECT_EQ(access::order(forked), order::serial);
  EXPECT_NE(forked.stream, recorded.stream);
  branch.join(recorded);
  recorded.wait();
}
TEST(launches, are_early_and_concurrent_in_recordings_only) {
  for (order const o : {order::serial, order::concurrent, order::full_wave}) {
    ft::detail::launch_target const plain{nullptr, false, o};
    EXPECT_FALSE(plain.early());
    EXPECT_FALSE(plain.concurrent());
    ft::detail::launch_target const recorded{nullptr, true, o};
    EXPECT_EQ(recorded.early(), o != order::full_wave);
    EXPECT_EQ(recorded.concurrent(), o == order::concurrent);
  }
}
#endif

}  // namespace side_branch_test
