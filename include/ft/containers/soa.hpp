// SPDX-License-Identifier: Apache-2.0
/// @file Structure of arrays with named fields, a batch axis and a count per batch entry.
///
/// A field is a tag type, declared by FT_FIELD(name, type). `soa<Space, Fields...>` owns one array
/// per field; `soa_view<Fields...>` is its view for kernels. Views convert to views of fewer
/// fields, so a container with an additional user-defined field can be passed wherever the plain
/// one is expected:
///
///     FT_FIELD(landmark_id, int);
///     ft::soa<ft::memory_space::host, ft::field::x, ft::field::y, landmark_id> mine(1000);
///     mine.view().landmark_id(3) = 7;
///
/// `get<Field>(view, i)` is the same element where the field is a template argument.
#pragma once

#include <cstddef>
#include <type_traits>
#include <utility>

#include "ft/containers/columns.hpp"
#include "ft/core/config.hpp"
#include "ft/core/execution.hpp"
#include "ft/core/memory.hpp"

namespace ft {
inline namespace FT_ABI {

/// Declares a field: a tag type NAME with the type of its elements, and the accessor NAME(i) of
/// every view with that field.
#define FT_FIELD(NAME, ...)                                                                        \
  struct NAME {                                                                                    \
    using type = __VA_ARGS__;                                                                      \
    template <typename Column>                                                                     \
    struct accessor {                                                                              \
      FT_HOST_DEVICE type& NAME(int i) const { return static_cast<Column const*>(this)->data[i]; } \
    };                                                                                             \
  }

namespace detail {

/// The accessor of a field, if it has one. A tag with only a `type` is a field, too.
template <typename Column, typename Field, typename = void>
struct accessor_of {};
template <typename Column, typename Field>
struct accessor_of<Column, Field, std::void_t<typename Field::template accessor<Column>>>
    : Field::template accessor<Column> {};

}  // namespace detail

template <typename Field>
struct column : detail::accessor_of<column<Field>, Field> {
  typename Field::type* data = nullptr;
};

/// Entry i of batch entry b is at `b * capacity + i` of every column.
template <typename... Fields>
struct soa_view : column<Fields>... {
  int capacity = 0;      ///< entries per batch entry
  int batch = 0;         ///< batch entries
  int* count = nullptr;  ///< [batch], entries in use, each at most capacity

  soa_view() = default;
  /// A view of fewer fields.
  template <typename... Others,
            typename = std::enable_if_t<
                (std::is_base_of<column<Fields>, soa_view<Others...>>::value && ...)>>
  FT_HOST_DEVICE soa_view(soa_view<Others...> const& other)  // NOLINT(google-explicit-constructor)
      : column<Fields>(static_cast<column<Fields> const&>(other))...,
        capacity(other.capacity),
        batch(other.batch),
        count(other.count) {}

  template <typename Visit>
  void columns(Visit&& each) {
    each({batch, capacity}, static_cast<column<Fields>&>(*this).data...);
    each({batch}, count);
  }
  /// Only batch entry b.
  FT_HOST_DEVICE soa_view slice(int b) const {
    soa_view r(*this);
    std::ptrdiff_t const offset = static_cast<std::ptrdiff_t>(b) * capacity;
    ((static_cast<column<Fields>&>(r).data += offset), ...);
    r.count += b;
    r.batch = 1;
    return r;
  }
};

/// Element i of a field.
template <typename Field, typename... Fields>
FT_HOST_DEVICE typename Field::type& get(soa_view<Fields...> const& v, int i) {
  return static_cast<column<Field> const&>(v).data[i];
}
/// A field's array.
template <typename Field, typename... Fields>
FT_HOST_DEVICE typename Field::type* array_of(soa_view<Fields...> const& v) {
  return static_cast<column<Field> const&>(v).data;
}

/// `base` with the columns of `other` instead of its own, such as keypoints with undistorted
/// positions. Copies nothing; counts are those of `base`.
/// @throws bad_argument for different shapes
template <typename... Fields, typename... Others>
soa_view<Fields...> with_columns(soa_view<Fields...> base, soa_view<Others...> const& other) {
  static_assert((std::is_base_of<column<Others>, soa_view<Fields...>>::value && ...),
                "every replaced column is one of the view's");
  detail::require(base.capacity == other.capacity && base.batch == other.batch,
                  "columns of another shape cannot be taken");
  ((static_cast<column<Others>&>(base).data = array_of<Others>(other)), ...);
  return base;
}

/// Places the columns and counts of a container into an arena.
template <typename... Fields>
void carve(carver& c, soa_view<Fields...>& v, int capacity, int batch) {
  v.capacity = capacity;
  v.batch = batch;
  detail::place_columns(c, v);
}

/// Owner of the arrays; move-only. Elements and counts are not initialised.
template <memory_space Space, typename... Fields>
class soa : public owner<soa_view<Fields...>, Space> {
public:
  using view_type = soa_view<Fields...>;
  static_assert(std::is_trivially_copyable<view_type>::value, "passed to kernels");

  soa() = default;
  /// @param capacity entries per batch entry @param batch batch entries
  /// @throws bad_argument below 1, std::bad_alloc, cuda_error
  explicit soa(int capacity, int batch = 1)
      : owner<view_type, Space>([&](carver& c, view_type& v) {
          detail::require(capacity >= 1 && batch >= 1,
                          "soa needs a capacity and a batch of 1 or more");
          carve(c, v, capacity, batch);
        }) {}

  int capacity() const { return this->view().capacity; }
  int batch() const { return this->view().batch; }
};

/// Sets all bytes of all columns and counts. Asynchronous if the executor is.
template <typename Exec, typename... Fields>
void fill(Exec const& exec, soa_view<Fields...> const& to, int value) {
  detail::fill_columns(exec, to, value);
}

/// Copies all columns and counts between containers of equal shape, in any spaces. Asynchronous if
/// the executor is; allocates nothing.
/// @throws bad_argument for different shapes
template <typename Exec, typename... Fields>
void copy(Exec const& exec, soa_view<Fields...> const& to, soa_view<Fields...> const& from) {
  detail::require(to.capacity == from.capacity && to.batch == from.batch,
                  "copy between containers of different shape");
  detail::copy_columns(exec, to, from);
}

/// A copy of a container in memory that the host reads: pinned next to a device, plain otherwise.
/// Waits for the executor, and allocates: for occasional results, not for every frame.
/// @throws std::bad_alloc, cuda_error
template <typename Exec, typename... Fields>
soa<staging_space<Exec>, Fields...> download(Exec const& exec, soa_view<Fields...> const& from) {
  soa<staging_space<Exec>, Fields...> to(from.capacity, from.batch);
  copy(exec, to.view(), from);
  exec.wait();
  return to;
}

}  // namespace FT_ABI
}  // namespace ft
