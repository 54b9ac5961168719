// SPDX-License-Identifier: Apache-2.0
// Owning buffers, the carver and the arena, in every executor's memory.
#include "ft/core/memory.hpp"

#include <gtest/gtest.h>

#include <cstddef>
#include <cstdint>
#include <limits>
#include <new>
#include <string>
#include <type_traits>
#include <utility>
#include <vector>

#include "ft/containers/soa.hpp"
#include "ft/core/error.hpp"
#include "ft/core/execution.hpp"
#include "tests/support/backends.hpp"
#include "tests/support/effort.hpp"
#include "tests/support/refusals.hpp"

namespace memory_test {

inline constexpr std::size_t largest = std::numeric_limits<std::size_t>::max();

inline bool aligned(void const* p) { return reinterpret_cast<std::uintptr_t>(p) % 256 == 0; }

template <typename Backend>
class memory_unit : public test::on_backend<Backend> {
protected:
  Backend backend;
  static constexpr ft::memory_space space = Backend::exec_type::space;
};
TYPED_TEST_SUITE(memory_unit, test::backends);

TYPED_TEST(memory_unit, a_buffer_knows_its_size) {
  using buffer = ft::buffer<double, TypeParam::exec_type::space>;
  buffer const b(17);
  EXPECT_NE(b.data(), nullptr);
  EXPECT_TRUE(aligned(b.data()));
  EXPECT_EQ(b.size(), 17u);
  EXPECT_EQ(b.bytes(), 17u * sizeof(double));
  EXPECT_FALSE(std::is_copy_constructible<buffer>::value);
  EXPECT_FALSE(std::is_copy_assignable<buffer>::value);
}

TYPED_TEST(memory_unit, an_empty_buffer_holds_nothing) {
  ft::buffer<int, TypeParam::exec_type::space> const none;
  ft::buffer<int, TypeParam::exec_type::space> const zero(0);
  for (auto const* b : {&none, &zero}) {
    EXPECT_EQ(b->data(), nullptr);
    EXPECT_EQ(b->size(), 0u);
    EXPECT_EQ(b->bytes(), 0u);
  }
  ft::copy(this->backend.exec, none.data(), static_cast<int const*>(zero.data()), 0);
  ft::fill_bytes(this->backend.exec, none.data(), 1, 0);
  EXPECT_NO_THROW(this->backend.exec.wait());
}

TYPED_TEST(memory_unit, a_moved_buffer_keeps_its_contents_and_leaves_nothing) {
  std::vector<int> const values{3, 1, 4, 1, 5};
  auto first = test::to_exec(this->backend.exec, values);
  int const* const where = first.data();
  ft::buffer<int, TypeParam::exec_type::space> second(std::move(first));
  EXPECT_EQ(first.data(),
            nullptr);  // NOLINT(bugprone-use-after-move): the moved-from state is documented
  EXPECT_EQ(first.size(), 0u);
  EXPECT_EQ(second.data(), where);

  ft::buffer<int, TypeParam::exec_type::space> third(2);  // its own memory is given back
  third = std::move(second);
  EXPECT_EQ(second.data(), nullptr);  // NOLINT(bugprone-use-after-move)
  EXPECT_EQ(second.size(), 0u);
  EXPECT_EQ(third.data(), where);
  EXPECT_EQ(
      test::from_exec(this->backend.exec, static_cast<int const*>(third.data()), third.size()),
      values);

  auto& same = third;
  third = std::move(same);
  EXPECT_EQ(third.data(), where);
  EXPECT_EQ(third.size(), values.size());
}

TYPED_TEST(memory_unit, a_size_that_does_not_fit_throws) {
  using buffer = ft::buffer<double, TypeParam::exec_type::space>;
  EXPECT_THROW(buffer(largest / sizeof(double) + 1), ft::bad_argument);
  EXPECT_THROW(buffer{largest}, ft::bad_argument);
#if !FT_TEST_ASAN  // which ends the program instead of throwing
  using bytes = ft::buffer<std::byte, TypeParam::exec_type::space>;
  if (TypeParam::exec_type::space == ft::memory_space::host) {
    EXPECT_THROW(bytes(largest / 4), std::bad_alloc);
  } else {
    EXPECT_THROW(bytes(largest / 4), ft::cuda_error);
    EXPECT_NO_THROW(bytes(16)) << "the error must not stick";
  }
#endif
}

TYPED_TEST(memory_unit, copies_and_fills_reach_every_byte) {
  auto const& exec = this->backend.exec;
  ft::buffer<unsigned char, TypeParam::exec_type::space> b(100);
  ft::fill_bytes(exec, b.data(), 0xa5, 100);
  std::vector<unsigned char> rows(5 * 7);
  for (std::size_t i = 0; i < rows.size(); ++i) { rows[i] = static_cast<unsigned char>(i); }
  ft::copy_rows(exec, {b.data() + 10, 13}, {rows.data(), 7}, 4, 5);  // 5 rows of 4 bytes
  auto const got = test::from_exec(exec, static_cast<unsigned char const*>(b.data()), 100);
  std::vector<unsigned char> want(100, 0xa5);
  for (std::size_t y = 0; y < 5; ++y) {
    for (std::size_t x = 0; x < 4; ++x) { want[10 + 13 * y + x] = rows[7 * y + x]; }
  }
  EXPECT_EQ(got, want);
}

/// Pieces of one layout.
struct pieces {
  char* a = nullptr;
  double* b = nullptr;
  int* none = nullptr;
  std::uint16_t* c = nullptr;

  void layout(ft::carver& carver) {
    a = carver.take<char>(3);
    b = carver.take<double>(33);
    none = carver.take<int>(0);
    c = carver.take<std::uint16_t>(1000);
  }
};

TYPED_TEST(memory_unit, an_arena_runs_its_layout_twice_and_aligns_every_piece) {
  pieces p;
  int calls = 0;
  std::vector<std::size_t> used;
  ft::arena<TypeParam::exec_type::space> const memory([&](ft::carver& carver) {
    ++calls;
    p.layout(carver);
    used.push_back(carver.used());
  });
  EXPECT_EQ(calls, 2);
  ASSERT_EQ(used.size(), 2u);
  EXPECT_EQ(used[0], used[1]) << "both passes must give the same pieces";
  EXPECT_EQ(used[0], 256u + 512u + 2000u) << "sizes rounded up to 256 but for the last";
  EXPECT_GE(memory.bytes(), used[0]);
  for (void const* piece : {static_cast<void const*>(p.a), static_cast<void const*>(p.b),
                            static_cast<void const*>(p.none), static_cast<void const*>(p.c)}) {
    EXPECT_TRUE(aligned(piece));
    EXPECT_GE(piece, static_cast<void const*>(memory.data()));
    EXPECT_LE(piece, static_cast<void const*>(memory.data() + memory.bytes()));
  }
  EXPECT_EQ(static_cast<void const*>(p.b), p.a + 256);
  EXPECT_EQ(static_cast<void const*>(p.none), reinterpret_cast<char*>(p.b) + 512);
  EXPECT_EQ(static_cast<void const*>(p.c), static_cast<void const*>(p.none));
  ft::fill_bytes(this->backend.exec, memory.data(), 1, memory.bytes());
  EXPECT_NO_THROW(this->backend.exec.wait());
}

TYPED_TEST(memory_unit, an_arena_of_nothing_can_be_made) {
  ft::arena<TypeParam::exec_type::space> const unmade;
  EXPECT_EQ(unmade.data(), nullptr);
  EXPECT_EQ(unmade.bytes(), 0u);
  int* piece = nullptr;
  ft::arena<TypeParam::exec_type::space> const empty(
      [&](ft::carver& carver) { piece = carver.take<int>(0); });
  EXPECT_NE(empty.data(), nullptr);
  EXPECT_EQ(static_cast<void*>(piece), static_cast<void*>(empty.data()));
}

TYPED_TEST(memory_unit, an_owner_gives_view_and_memory_away_together) {
  struct numbers {
    int first = 3;
    int* data = nullptr;
  };
  using owner = ft::owner<numbers, TypeParam::exec_type::space>;
  numbers initial;
  initial.first = 7;
  owner made([](ft::carver& c, numbers& n) { n.data = c.take<int>(10); }, initial);
  EXPECT_EQ(made->first, 7) << "what the layout does not set";
  int* const data = made->data;
  EXPECT_TRUE(aligned(data));
  EXPECT_GE(made.bytes(), 10 * sizeof(int));
  EXPECT_NO_THROW(made.require_made("thing"));

  owner taken(std::move(made));
  // NOLINTBEGIN(bugprone-use-after-move): what is left is what is tested
  EXPECT_EQ(made->data, nullptr);
  EXPECT_EQ(made.view().first, 3) << "as one that was never made";
  EXPECT_EQ(made.bytes(), 0u);
  EXPECT_THROW(made.require_made("thing"), ft::bad_argument);
  EXPECT_EQ(taken->data, data);
  made = std::move(taken);
  EXPECT_EQ(made->data, data);
  EXPECT_EQ(made->first, 7);
  EXPECT_THROW(taken.require_made("thing"), ft::bad_argument);
  // NOLINTEND(bugprone-use-after-move)
  EXPECT_THROW(owner().require_made("thing"), ft::bad_argument);
}

TEST(carver_unit, a_measuring_carver_gives_null_and_counts) {
  ft::carver carver;
  EXPECT_EQ(carver.used(), 0u);
  EXPECT_EQ(carver.take<double>(1), nullptr);
  EXPECT_EQ(carver.used(), 8u);
  EXPECT_EQ(carver.take<double>(0), nullptr);
  EXPECT_EQ(carver.used(), 256u);
  EXPECT_EQ(carver.take<char>(257), nullptr);
  EXPECT_EQ(carver.used(), 513u);
}

TEST(carver_unit, a_piece_that_does_not_fit_an_address_space_throws) {
  {
    ft::carver carver;
    EXPECT_THROW(carver.take<double>(largest / 4), ft::bad_argument);
  }
  {
    ft::carver carver;
    carver.take<std::byte>(largest / 2);
    carver.take<std::byte>(largest / 2 - 1024);
    EXPECT_THROW(carver.take<std::byte>(4096), ft::bad_argument);
  }
}

TEST(carver_unit, arrays_of_one_extent_follow_each_other) {
  ft::arena<ft::memory_space::host> const arena([](ft::carver& c) { c.take<std::byte>(4096); });
  ft::carver carver(arena.data());
  int* first = nullptr;
  double* second = nullptr;
  char* third = nullptr;
  carver.place({3, 5, 20}, first, second);
  carver.place({7}, third);
  auto const offset = [&](void* p) { return static_cast<std::byte*>(p) - arena.data(); };
  EXPECT_EQ(offset(first), 0);
  EXPECT_EQ(offset(second), 1280) << "300 ints, rounded up to 256 bytes";
  EXPECT_EQ(offset(third), 3840);
  EXPECT_EQ(carver.used(), 3847u);
  EXPECT_THROW(carver.place({largest / 4, 2, 4}, third), ft::bad_argument);
  EXPECT_THROW(carver.place({-1, 3}, third), ft::bad_argument);
}

TEST(carver_unit, rounding_up_at_the_end_of_an_address_space_throws) {
  ft::carver carver;
  carver.take<std::byte>(largest - 10);
  EXPECT_THROW(carver.take<std::byte>(1), ft::bad_argument)
      << "the next multiple of 256 does not exist";
}

TEST(checked_mul_unit, refuses_what_overflows_and_nothing_else) {
  std::size_t const halved = std::size_t{1} << 32;
  EXPECT_EQ(ft::detail::checked_mul(0, largest), 0u);
  EXPECT_EQ(ft::detail::checked_mul(largest, 0), 0u);
  EXPECT_EQ(ft::detail::checked_mul(1, largest), largest);
  EXPECT_EQ(ft::detail::checked_mul(largest, 1), largest);
  EXPECT_EQ(ft::detail::checked_mul(halved, halved - 1), halved * (halved - 1));
  EXPECT_THROW(ft::detail::checked_mul(halved, halved), ft::bad_argument);
  EXPECT_THROW(ft::detail::checked_mul(largest / 2 + 1, 2), ft::bad_argument);
  EXPECT_THROW(ft::detail::checked_mul(largest, largest), ft::bad_argument);
}

TEST(require_unit, the_message_names_argument_value_and_limit) {
  EXPECT_NO_THROW(ft::detail::require_range("batch", 4, 1, 4));
  EXPECT_NO_THROW(ft::detail::require_range("batch", 1, 1, 4));
  EXPECT_THROW(
      ft::detail::require_range("scale", std::numeric_limits<float>::quiet_NaN(), 0.0f, 1.0f),
      ft::bad_argument);
  EXPECT_THROW(ft::detail::require_finite("fx", std::numeric_limits<double>::infinity()),
               ft::bad_argument);
  EXPECT_THROW(ft::detail::require(false, "no"), ft::error);
  EXPECT_EQ(test::refusal([] { ft::detail::require_range("batch", 5, 1, 4); }),
            "ft: batch is 5, must be in [1, 4]");
}

TEST(require_unit, the_message_shows_small_and_exact_numbers) {
  EXPECT_EQ(ft::detail::number_text(1e-7f), "1e-07");
  EXPECT_EQ(ft::detail::number_text(0.1f), "0.1");
  EXPECT_EQ(ft::detail::number_text(-2.0), "-2");
  EXPECT_EQ(std::stof(ft::detail::number_text(1.0000001f)), 1.0000001f);
  EXPECT_EQ(std::stod(ft::detail::number_text(1.0 / 3)), 1.0 / 3);
  EXPECT_EQ(ft::detail::number_text(std::numeric_limits<float>::infinity()), "inf");
  EXPECT_EQ(ft::detail::number_text(7), "7");
  EXPECT_EQ(test::refusal([] { ft::detail::require_range("baseline", 1e-7f, 1e-6f, 1e6f); }),
            "ft: baseline is 1e-07, must be in [1e-06, 1e+06]");
}

}  // namespace memory_test
