// SPDX-License-Identifier: Apache-2.0
// The structure of arrays: fields of one's own, views of fewer fields, slices, copies between
// spaces.
#include "ft/containers/soa.hpp"

#include <gtest/gtest.h>

#include <cstddef>
#include <cstdint>
#include <limits>
#include <type_traits>
#include <utility>
#include <vector>

#include "ft/containers/keypoints.hpp"
#include "ft/containers/map_points.hpp"
#include "ft/containers/stereo_matches.hpp"
#include "ft/core/execution.hpp"
#include "tests/support/backends.hpp"

namespace soa_test {

/// A user's own field, added to what a container has.
struct landmark_id {
  using type = std::int64_t;
};
template <ft::memory_space Space>
using labelled = ft::soa<Space, ft::field::x, landmark_id, ft::field::y>;
using labelled_view = ft::soa_view<ft::field::x, landmark_id, ft::field::y>;
using position_view = ft::soa_view<ft::field::y, ft::field::x>;

static_assert(std::is_trivially_copyable<labelled_view>::value, "passed to kernels");
static_assert(std::is_convertible<labelled_view, position_view>::value,
              "to fewer fields, in any order");
static_assert(!std::is_convertible<position_view, labelled_view>::value, "but not to more");
static_assert(std::is_convertible<ft::keypoints_view, position_view>::value,
              "ft's own containers too");
static_assert(!std::is_convertible<ft::stereo_matches_view, position_view>::value,
              "without the fields");
static_assert(!std::is_copy_constructible<labelled<ft::memory_space::host>>::value, "move-only");
static_assert(!std::is_copy_assignable<labelled<ft::memory_space::host>>::value, "move-only");

FT_FIELD(weight, double);
using weighted_view = ft::soa_view<ft::field::x, weight, landmark_id>;
static_assert(sizeof(weighted_view) == 3 * sizeof(void*) + 2 * sizeof(int) + sizeof(int*),
              "accessors take no space");

TEST(soa_fields, have_accessors_of_their_names) {
  ft::soa<ft::memory_space::host, ft::field::x, weight, landmark_id> const owner(5, 2);
  weighted_view const v = owner.view();
  for (int i = 0; i < 10; ++i) {
    v.x(i) = static_cast<float>(i);
    v.weight(i) = i + 0.5;
    ft::get<landmark_id>(v, i) = 7 * i;  // a tag with a type alone
  }
  for (int i = 0; i < 10; ++i) {
    EXPECT_EQ(ft::get<ft::field::x>(v, i), static_cast<float>(i));
    EXPECT_EQ(ft::array_of<weight>(v)[i], i + 0.5);
    EXPECT_EQ(&v.weight(i), &ft::get<weight>(v, i));
  }
  EXPECT_EQ(v.slice(1).x(2), 7.0f);
  ft::soa_view<weight> const fewer = v;
  EXPECT_EQ(&fewer.weight(3), &v.weight(3));
}

/// Writes to every entry through a view of two fields and a slice.
struct write_positions {
  using scratch = ft::no_scratch;
  template <typename Group>
  FT_HOST_DEVICE void operator()(Group, scratch&, int item, position_view const& all) const {
    position_view const mine = all.slice(item / all.capacity);
    int const i = item % all.capacity;
    ft::get<ft::field::x>(mine, i) = static_cast<float>(item);
    ft::get<ft::field::y>(mine, i) = static_cast<float>(-item);
    if (i == 0) { *mine.count = item; }
  }
};

template <typename Backend>
class soa_unit : public test::on_backend<Backend> {
protected:
  Backend backend;
};
TYPED_TEST_SUITE(soa_unit, test::backends);

TYPED_TEST(soa_unit, a_view_of_fewer_fields_writes_into_the_whole) {
  auto const& exec = this->backend.exec;
  constexpr int capacity = 37;
  constexpr int batch = 3;
  labelled<TypeParam::exec_type::space> const owner(capacity, batch);
  labelled_view const v = owner.view();
  EXPECT_EQ(owner.capacity(), capacity);
  EXPECT_EQ(owner.batch(), batch);
  EXPECT_EQ(v.capacity, capacity);
  EXPECT_EQ(v.batch, batch);
  ft::fill_bytes(exec, ft::array_of<landmark_id>(v), 0x11, capacity * batch * sizeof(std::int64_t));
  position_view const positions = v;
  EXPECT_EQ(ft::array_of<ft::field::x>(positions), ft::array_of<ft::field::x>(v));
  EXPECT_EQ(positions.count, v.count);
  ft::for_each_item<ft::per_thread>(exec, capacity * batch, write_positions{}, positions);
  auto const x = test::column<ft::field::x>(exec, v);
  auto const y = test::column<ft::field::y>(exec, v);
  auto const id = test::column<landmark_id>(exec, v);
  for (std::size_t i = 0; i < x.size(); ++i) {
    EXPECT_EQ(x[i], static_cast<float>(i));
    EXPECT_EQ(y[i], -static_cast<float>(i));
    EXPECT_EQ(id[i], 0x1111111111111111) << "the user's field is left alone";
  }
  EXPECT_EQ(test::from_exec(exec, static_cast<int const*>(v.count), batch),
            (std::vector<int>{0, capacity, 2 * capacity}));
}

TYPED_TEST(soa_unit, a_slice_is_one_batch_entry) {
  labelled<TypeParam::exec_type::space> const owner(10, 4);
  labelled_view const v = owner.view();
  for (int b = 0; b < 4; ++b) {
    labelled_view const s = v.slice(b);
    EXPECT_EQ(ft::array_of<ft::field::x>(s), ft::array_of<ft::field::x>(v) + 10 * b);
    EXPECT_EQ(ft::array_of<landmark_id>(s), ft::array_of<landmark_id>(v) + 10 * b);
    EXPECT_EQ(ft::array_of<ft::field::y>(s), ft::array_of<ft::field::y>(v) + 10 * b);
    EXPECT_EQ(s.count, v.count + b);
    EXPECT_EQ(s.capacity, 10);
    EXPECT_EQ(s.batch, 1);
  }
}

TYPED_TEST(soa_unit, a_download_is_a_copy_that_the_host_reads) {
  auto const& exec = this->backend.exec;
  labelled<TypeParam::exec_type::space> const owner(7, 3);
  ft::fill(exec, owner.view(), 0);
  ft::for_each_item<ft::per_thread>(exec, 7 * 3, write_positions{}, position_view(owner.view()));
  auto const there = ft::download(exec, owner.view());
  EXPECT_EQ(there.capacity(), 7);
  EXPECT_EQ(there.batch(), 3);
  for (int i = 0; i < 7 * 3; ++i) {
    EXPECT_EQ(ft::get<ft::field::x>(there.view(), i), static_cast<float>(i));
    EXPECT_EQ(ft::get<landmark_id>(there.view(), i), 0);
  }
  for (int b = 0; b < 3; ++b) { EXPECT_EQ(there.view().count[b], 7 * b); }
}

TYPED_TEST(soa_unit, copies_travel_between_spaces) {
  auto const& exec = this->backend.exec;
  constexpr auto staging = ft::staging_space<typename TypeParam::exec_type>;
  ft::map_points<staging> const from(9, 2);
  ft::map_points<TypeParam::exec_type::space> const there(9, 2);
  ft::map_points<ft::memory_space::host> const back(9, 2);
  for (int i = 0; i < 18; ++i) {
    auto const f = static_cast<float>(i);
    ft::get<ft::field::position>(from.view(), i) = {f, f + 0.5f, f + 0.25f};
    ft::get<ft::field::normal>(from.view(), i) = {-f, 1, 0};
    ft::get<ft::field::min_distance>(from.view(), i) = f;
    ft::get<ft::field::max_distance>(from.view(), i) = 2 * f;
    ft::get<ft::field::observations>(from.view(), i) = i;
    ft::get<ft::field::orb>(from.view(),
                            i) = {{1, 2, 3, 4, 5, 6, 7, static_cast<std::uint32_t>(i)}};
  }
  from.view().count[0] = 9;
  from.view().count[1] = 4;
  ft::copy(exec, there.view(), from.view());
  ft::copy(exec, back.view(), there.view());
  exec.wait();
  for (int i = 0; i < 18; ++i) {
    auto const f = static_cast<float>(i);
    EXPECT_EQ(ft::get<ft::field::position>(back.view(), i).y, f + 0.5f);
    EXPECT_EQ(ft::get<ft::field::normal>(back.view(), i).x, -f);
    EXPECT_EQ(ft::get<ft::field::min_distance>(back.view(), i), f);
    EXPECT_EQ(ft::get<ft::field::max_distance>(back.view(), i), 2 * f);
    EXPECT_EQ(ft::get<ft::field::observations>(back.view(), i), i);
    EXPECT_EQ(ft::get<ft::field::orb>(back.view(), i).words[7], static_cast<std::uint32_t>(i));
  }
  EXPECT_EQ(back.view().count[0], 9);
  EXPECT_EQ(back.view().count[1], 4);
}

TYPED_TEST(soa_unit, a_copy_of_another_shape_throws) {
  auto const& exec = this->backend.exec;
  using matches = ft::stereo_matches<TypeParam::exec_type::space>;
  matches const a(10, 2);
  matches const other_capacity(11, 2);
  matches const other_batch(10, 1);
  matches const same_number(5, 4);
  EXPECT_THROW(ft::copy(exec, a.view(), other_capacity.view()), ft::bad_argument);
  EXPECT_THROW(ft::copy(exec, a.view(), other_batch.view()), ft::bad_argument);
  EXPECT_THROW(ft::copy(exec, same_number.view(), a.view()), ft::bad_argument);
}

TYPED_TEST(soa_unit, a_shape_that_cannot_be_throws) {
  using owner = labelled<TypeParam::exec_type::space>;
  constexpr int most = std::numeric_limits<int>::max();
  EXPECT_THROW(owner(0), ft::bad_argument);
  EXPECT_THROW(owner(-1), ft::bad_argument);
  EXPECT_THROW(owner(1, 0), ft::bad_argument);
  EXPECT_THROW(owner(1, -3), ft::bad_argument);
  EXPECT_THROW(owner(most, most), ft::bad_argument) << "more bytes than an address holds";
  EXPECT_NO_THROW(owner(1));
}

TYPED_TEST(soa_unit, a_move_leaves_the_source_empty) {
  using owner = labelled<TypeParam::exec_type::space>;
  owner first(12, 2);
  labelled_view const v = first.view();
  owner second(std::move(first));
  EXPECT_EQ(first.capacity(),
            0);  // NOLINT(bugprone-use-after-move): the moved-from state is documented
  EXPECT_EQ(first.batch(), 0);
  EXPECT_EQ(ft::array_of<landmark_id>(first.view()), nullptr);
  EXPECT_EQ(first.view().count, nullptr);
  EXPECT_EQ(ft::array_of<landmark_id>(second.view()), ft::array_of<landmark_id>(v));
  EXPECT_EQ(second.capacity(), 12);

  owner third(1);
  third = std::move(second);
  EXPECT_EQ(second.capacity(), 0);  // NOLINT(bugprone-use-after-move)
  EXPECT_EQ(second.view().count, nullptr);
  EXPECT_EQ(third.view().count, v.count);
  EXPECT_EQ(third.batch(), 2);
  auto& same = third;
  third = std::move(same);
  EXPECT_EQ(third.view().count, v.count);
  EXPECT_EQ(third.capacity(), 12);
}

TYPED_TEST(soa_unit, columns_do_not_overlap) {
  labelled<TypeParam::exec_type::space> const owner(33, 3);
  labelled_view const v = owner.view();
  auto const begin = [](auto const* p) { return reinterpret_cast<std::uintptr_t>(p); };
  std::vector<std::pair<std::uintptr_t, std::uintptr_t>> ranges{
      {begin(ft::array_of<ft::field::x>(v)), begin(ft::array_of<ft::field::x>(v) + 99)},
      {begin(ft::array_of<landmark_id>(v)), begin(ft::array_of<landmark_id>(v) + 99)},
      {begin(ft::array_of<ft::field::y>(v)), begin(ft::array_of<ft::field::y>(v) + 99)},
      {begin(v.count), begin(v.count + 3)}};
  for (std::size_t i = 0; i < ranges.size(); ++i) {
    EXPECT_EQ(ranges[i].first % 256, 0u);
    for (std::size_t j = 0; j < i; ++j) {
      EXPECT_TRUE(ranges[i].second <= ranges[j].first || ranges[j].second <= ranges[i].first);
    }
  }
}

TYPED_TEST(soa_unit, columns_of_another_container_take_the_place_of_ones_own) {
  constexpr ft::memory_space space = TypeParam::exec_type::space;
  ft::keypoints<space> const keypoints(9, 2);
  ft::soa<space, ft::field::y, ft::field::x> const places(9, 2);
  auto const v = ft::with_columns(keypoints.view(), places.view());
  EXPECT_EQ(ft::array_of<ft::field::x>(v), ft::array_of<ft::field::x>(places.view()));
  EXPECT_EQ(ft::array_of<ft::field::y>(v), ft::array_of<ft::field::y>(places.view()));
  EXPECT_EQ(ft::array_of<ft::field::orb>(v), ft::array_of<ft::field::orb>(keypoints.view()));
  EXPECT_EQ(ft::array_of<ft::field::octave>(v), ft::array_of<ft::field::octave>(keypoints.view()));
  EXPECT_EQ(v.count, keypoints.view().count);
  EXPECT_EQ(v.capacity, 9);
  EXPECT_EQ(v.batch, 2);
  ft::soa<space, ft::field::x> const longer(10, 2);
  ft::soa<space, ft::field::x> const more(9, 3);
  EXPECT_THROW(ft::with_columns(keypoints.view(), longer.view()), ft::bad_argument);
  EXPECT_THROW(ft::with_columns(keypoints.view(), more.view()), ft::bad_argument);
}

/// A view with a view in it.
struct nested_view {
  int batch = 0;
  labelled_view labels;
  int* sizes = nullptr;         ///< [batch]
  std::int16_t* all = nullptr;  ///< [batch][3][4]
  float* absent = nullptr;      ///< [batch][3]

  template <typename Visit>
  void columns(Visit&& each) {
    labels.columns(each);
    each({batch}, sizes);
    each({batch, 3, 4}, all);
    if (absent != nullptr) { each({batch, 3}, absent); }
  }
};
template <ft::memory_space Space>
ft::owner<nested_view, Space> nested(int capacity, int batch) {
  return ft::owner<nested_view, Space>([&](ft::carver& c, nested_view& v) {
    v.batch = v.labels.batch = batch;
    v.labels.capacity = capacity;
    ft::detail::place_columns(c, v);
  });
}

TEST(columns_unit, entries_are_skipped_in_all_arrays_of_a_view) {
  auto const owner = nested<ft::memory_space::host>(7, 5);
  nested_view const v = owner.view();
  nested_view const rest = ft::detail::skip_entries(v, 2);
  EXPECT_EQ(ft::array_of<ft::field::x>(rest.labels), ft::array_of<ft::field::x>(v.labels) + 14);
  EXPECT_EQ(ft::array_of<landmark_id>(rest.labels), ft::array_of<landmark_id>(v.labels) + 14);
  EXPECT_EQ(rest.labels.count, v.labels.count + 2);
  EXPECT_EQ(rest.sizes, v.sizes + 2);
  EXPECT_EQ(rest.all, v.all + 24);
  EXPECT_EQ(rest.absent, nullptr);
}

TYPED_TEST(soa_unit, all_columns_of_a_view_are_filled_and_copied) {
  constexpr ft::memory_space space = TypeParam::exec_type::space;
  auto const& exec = this->backend.exec;
  auto const here = nested<ft::staging_space<typename TypeParam::exec_type>>(7, 5);
  auto const there = nested<space>(7, 5);
  auto const back = nested<ft::staging_space<typename TypeParam::exec_type>>(7, 5);
  ft::detail::fill_columns(exec, there.view(), 0x11);
  ft::detail::copy_columns(exec, here.view(), there.view());
  exec.wait();
  for (int i = 0; i < 60; ++i) { here->all[i] = static_cast<std::int16_t>(i); }
  here->labels.count[4] = 3;
  ft::detail::copy_columns(exec, there.view(), here.view());
  ft::detail::copy_columns(exec, back.view(), there.view());
  exec.wait();
  for (int i = 0; i < 60; ++i) { EXPECT_EQ(back->all[i], i); }
  for (int i = 0; i < 35; ++i) {
    EXPECT_EQ(ft::get<landmark_id>(back->labels, i), 0x1111111111111111);
  }
  for (int b = 0; b < 5; ++b) {
    EXPECT_EQ(back->sizes[b], 0x11111111);
    EXPECT_EQ(back->labels.count[b], b == 4 ? 3 : 0x11111111);
  }
}

}  // namespace soa_test
