// SPDX-License-Identifier: Apache-2.0
// The hooks of a stage's functor: which are seen, which are refused, and what a prologue does.
#include "ft/core/stage.hpp"

#include <gtest/gtest.h>

#include <cstddef>
#include <vector>

#include "ft/core/execution.hpp"
#include "ft/core/memory.hpp"
#include "ft/core/recording.hpp"
#include "tests/support/backends.hpp"

namespace stage_test {

namespace hooks = ft::detail;

struct plain {
  using scratch = ft::no_scratch;
  template <typename Group>
  FT_HOST_DEVICE void operator()(Group, scratch&, int, int*) const {}
};
struct with_all {
  using scratch = int;
  static constexpr bool wide_on_host = true;
  static constexpr bool prefers_shared = true;
  static constexpr int resident_blocks = 3;
  std::size_t extra_bytes() const { return 96; }
  template <typename Group>
  FT_HOST_DEVICE void prologue(Group, scratch&, int, int*) const {}
  template <typename Group>
  FT_HOST_DEVICE void operator()(Group, scratch&, int, int*) const {}
};
struct that_says_no {
  using scratch = ft::no_scratch;
  static constexpr bool wide_on_host = false;
  template <typename Group>
  FT_HOST_DEVICE static bool prologue(Group, scratch&, int, int*) {
    return false;
  }
};
struct with_wrong_arguments {
  using scratch = ft::no_scratch;
  template <typename Group>
  FT_HOST_DEVICE void prologue(Group, scratch&, int) const {}
};
struct with_hidden_hook {
  using scratch = ft::no_scratch;

private:
  template <typename Group>
  FT_HOST_DEVICE void prologue(Group, scratch&, int, int*) const {}
};
struct with_old_names {
  static constexpr bool prepares = true;
  static constexpr int side_by_side = 2;
};
struct that_inherits : with_all {};
struct without_scratch {
  template <typename Group>
  FT_HOST_DEVICE void operator()(Group, ft::no_scratch&, int, int*) const {}
};
struct that_changes {
  using scratch = ft::no_scratch;
  template <typename Group>
  FT_HOST_DEVICE void operator()(Group, scratch&, int, int*) {}  // not const
};
struct with_hidden_operator {
  using scratch = ft::no_scratch;

private:
  template <typename Group>
  FT_HOST_DEVICE void operator()(Group, scratch&, int, int*) const {}
};

template <typename Op>
constexpr bool takes_pointer = hooks::takes_prologue<Op, ft::single_group, void, int*>;

TEST(stage_hooks, are_seen) {
  using none = hooks::stage_traits<plain>;
  EXPECT_FALSE(none::has_prologue);
  EXPECT_FALSE(none::wide_on_host);
  EXPECT_FALSE(none::prefers_shared);
  EXPECT_EQ(int{none::resident_blocks}, 0);
  EXPECT_EQ(none::extra_bytes({}), 0u);
  using all = hooks::stage_traits<with_all>;
  EXPECT_TRUE(all::has_prologue);
  EXPECT_TRUE(all::wide_on_host);
  EXPECT_TRUE(all::prefers_shared);
  EXPECT_EQ(int{all::resident_blocks}, 3);
  EXPECT_EQ(all::extra_bytes({}), 96u);
  EXPECT_FALSE(hooks::stage_traits<that_says_no>::wide_on_host);
  EXPECT_TRUE(hooks::stage_traits<that_inherits>::has_prologue);
}

template <typename Op>
constexpr bool runs = hooks::takes_item<Op, ft::single_group, void, int*>;

TEST(stage_form, is_known_before_a_stage_is_compiled) {
  EXPECT_TRUE(runs<plain>);
  EXPECT_TRUE(runs<with_all>);
  EXPECT_TRUE(runs<that_inherits>);
  EXPECT_FALSE(hooks::has_scratch<without_scratch>);
  EXPECT_FALSE(runs<without_scratch>);
  EXPECT_TRUE(hooks::has_scratch<that_changes>);
  EXPECT_FALSE(runs<that_changes>);
  EXPECT_FALSE(runs<with_hidden_operator>);
  EXPECT_FALSE((hooks::takes_item<plain, ft::single_group, void, float*>));
  EXPECT_FALSE((hooks::takes_item<plain, ft::single_group, void>));
  EXPECT_TRUE((hooks::is_stage<plain, ft::single_group, int*>()));
}

TEST(stage_hooks, of_another_form_are_not_taken_for_absent) {
  EXPECT_TRUE(takes_pointer<with_all>);
  EXPECT_TRUE(takes_pointer<that_says_no>);
  EXPECT_TRUE(hooks::names_prologue<with_wrong_arguments>);
  EXPECT_FALSE(takes_pointer<with_wrong_arguments>);
  EXPECT_TRUE(hooks::names_prologue<with_hidden_hook>);
  EXPECT_FALSE(takes_pointer<with_hidden_hook>);
  EXPECT_TRUE(hooks::names_prepares<with_old_names>);
  EXPECT_TRUE(hooks::names_side_by_side<with_old_names>);
  EXPECT_FALSE(hooks::names_prepares<with_all>);
}

TEST(stage_hooks, of_a_prologue_say_whether_it_decides) {
  EXPECT_FALSE((hooks::prologue_decides<plain, ft::single_group, int*>()));
  EXPECT_FALSE((hooks::prologue_decides<with_all, ft::single_group, int*>()));
  EXPECT_TRUE((hooks::prologue_decides<that_says_no, ft::single_group, int*>()));
}

/// out[item] = in[item].
struct copy_item {
  using scratch = ft::no_scratch;
  template <typename Group>
  FT_HOST_DEVICE void operator()(Group, scratch&, int item, int const* in, int* out) const {
    out[item] = in[item];
  }
};
/// Adds to sum[item] what the prologue found in early[item], for items where that is odd.
struct add_odd {
  using scratch = int;
  template <typename Group>
  FT_HOST_DEVICE bool prologue(Group g, scratch& s, int item, int const* early, int const*,
                               int*) const {
    if (early[item] % 2 == 0) { return false; }
    if (g.rank() == 0) { s = early[item]; }
    g.sync();
    return true;
  }
  template <typename Group>
  FT_HOST_DEVICE void operator()(Group g, scratch& s, int item, int const*, int const* late,
                                 int* sum) const {
    if (g.rank() == 0) { sum[item] = s + late[item]; }
  }
};

template <typename Backend>
class stage_unit : public test::on_backend<Backend> {
protected:
  Backend backend;
};
TYPED_TEST_SUITE(stage_unit, test::backends);

TYPED_TEST(stage_unit, a_prologue_of_warps_decides_about_its_item_in_every_launch_order) {
  using executor = typename TypeParam::exec_type;
  using order = ft::detail::launch_order;
  auto const& exec = this->backend.exec;
  constexpr int n = 20003;
  constexpr auto count = static_cast<std::size_t>(n);
  using memory = ft::buffer<int, executor::space>;
  for (order const o : {order::serial, order::full_wave}) {
    memory const early(count);
    memory const between(count);
    memory const late(count);
    memory const sum(count);
    std::vector<int> values;
    for (int i = 0; i < n; ++i) { values.push_back(i * 7 % 1000); }
    auto const input = test::to_exec(exec, values);
    auto const copy = [](executor const& e, memory const& from, memory const& to) {
      ft::for_each_item<ft::per_thread>(e, n, copy_item{}, from.data(), to.data());
    };
    auto const queue = [&](executor const& e) {
      ft::fill_bytes(e, sum.data(), 0, sum.bytes());
      copy(e, input, early);
      copy(e, early, between);
      copy(e, between, late);
      ft::for_each_item<ft::per_warp>(ft::detail::with_order(e, o), n, add_odd{}, early.data(),
                                      late.data(), sum.data());
    };
    ft::recording<executor> recorded;
    recorded.record(exec, queue);
    for (int round = 0; round < 8; ++round) {
      for (memory const* m : {&early, &between, &late, &sum}) {
        ft::fill_bytes(exec, m->data(), 0x55, m->bytes());
      }
      round % 2 == 0 ? queue(exec) : recorded.replay(exec, queue);
      auto const got = test::from_exec(exec, sum.data(), count);
      for (std::size_t i = 0; i < count; ++i) {
        ASSERT_EQ(got[i], values[i] % 2 == 0 ? 0 : 2 * values[i]) << i << ", round " << round;
      }
    }
  }
}

TEST(host_executor, in_the_background_visits_every_item_once) {
  for (int const threads : {0, 1, 3}) {
    ft::host_exec const background = ft::host_exec(threads).in_background();
    std::vector<int> visits(1000);
    background.parallel_for(1000, [&](int i) { ++visits[static_cast<std::size_t>(i)]; });
    EXPECT_EQ(visits, std::vector<int>(1000, 1)) << threads;
  }
}

TEST(host_executor, both_calls_are_made_and_may_use_it) {
  for (int const threads : {0, 1, 3}) {
    ft::host_exec const exec(threads);
    std::vector<int> a(500);
    std::vector<int> b(700);
    auto const count = [&exec](std::vector<int>& visits) {
      exec.parallel_for(static_cast<int>(visits.size()),
                        [&](int i) { ++visits[static_cast<std::size_t>(i)]; });
    };
    exec.both([&] { count(a); }, [&] { count(b); });
    EXPECT_EQ(a, std::vector<int>(500, 1)) << threads;
    EXPECT_EQ(b, std::vector<int>(700, 1)) << threads;
    for (int const thrower : {0, 1}) {
      auto const call = [&](int i) {
        if (i == thrower) { throw ft::bad_argument("of one of both"); }
      };
      EXPECT_THROW(exec.both([&] { call(0); }, [&] { call(1); }), ft::bad_argument) << threads;
    }
  }
}

}  // namespace stage_test
