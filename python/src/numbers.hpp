// SPDX-License-Identifier: Apache-2.0
/// @file Numbers of Python as those of C++. What would lose something is refused by name.
#pragma once

#include <nanobind/nanobind.h>
#include <nanobind/stl/string.h>

#include <cmath>
#include <cstdint>
#include <limits>
#include <string>
#include <vector>

#include "python/src/api.hpp"

namespace ftpy {

namespace nb = nanobind;

/// What is given, for a message.
inline std::string text_of(nb::handle given) {
  nb::object const shape = nb::getattr(given, "shape", nb::none());
  if (nb::isinstance<nb::tuple>(shape) && nb::len(nb::handle(shape)) > 0) {
    return "an array of shape " + nb::cast<std::string>(nb::str(shape));
  }
  std::string const text = nb::cast<std::string>(nb::repr(given));
  return text.size() > 60 ? text.substr(0, 57) + "..." : text;
}

namespace detail {

/// An int of Python, also one of NumPy. Invalid for anything else.
inline nb::object integer_of(nb::handle given) {
  nb::object i = nb::steal(PyNumber_Index(given.ptr()));
  if (!i.is_valid()) { PyErr_Clear(); }
  return i;
}

inline argument_error outside(nb::handle given, std::string const& name, std::string const& least,
                              std::string const& most) {
  return argument_error(name + " is " + text_of(given) + ", must be in [" + least + ", " + most +
                        "]");
}

}  // namespace detail

/// An integer, or a floating-point number that has no fraction, as those of cv2.VideoCapture.get().
inline int whole(nb::handle given, std::string const& name, int least = -2147483647 - 1,
                 int most = 2147483647) {
  auto const refuse = [&] {
    return detail::outside(given, name, std::to_string(least), std::to_string(most));
  };
  if (nb::object const i = detail::integer_of(given); i.is_valid()) {
    int overflow = 0;
    long long const v = PyLong_AsLongLongAndOverflow(i.ptr(), &overflow);
    if (overflow != 0 || v < least || v > most) { throw refuse(); }
    return static_cast<int>(v);
  }
  double const v = PyFloat_AsDouble(given.ptr());
  if (PyErr_Occurred() != nullptr || !(v == std::floor(v))) {
    PyErr_Clear();
    throw argument_error(name + " is " + text_of(given) + ", must be a whole number");
  }
  if (v < least || v > most) { throw refuse(); }
  return static_cast<int>(v);
}

/// Floating-point numbers are refused: a double has 53 bits, times of today in ns take 61.
inline std::int64_t nanoseconds(nb::handle given, std::string const& name) {
  nb::object const i = detail::integer_of(given);
  if (!i.is_valid()) {
    throw argument_error(name + " is " + text_of(given) + " (" +
                         nb::cast<std::string>(given.type().attr("__name__")) +
                         "), must be an int, nanoseconds: round(1e9 * seconds)");
  }
  int overflow = 0;
  long long const v = PyLong_AsLongLongAndOverflow(i.ptr(), &overflow);
  if (overflow != 0) {
    using limits = std::numeric_limits<std::int64_t>;
    throw detail::outside(given, name, std::to_string(limits::min()),
                          std::to_string(limits::max()));
  }
  return v;
}

/// Any number; NaN and infinite ones, too.
inline double any_number(nb::handle given, std::string const& name) {
  double const v = PyFloat_AsDouble(given.ptr());
  if (PyErr_Occurred() != nullptr) {
    PyErr_Clear();
    throw argument_error(name + " is " + text_of(given) + ", must be a number");
  }
  return v;
}

/// A finite number that a float can hold.
inline double number(nb::handle given, std::string const& name) {
  double const v = any_number(given, name);
  if (!(std::abs(v) <= static_cast<double>(std::numeric_limits<float>::max()))) {
    throw argument_error(name + " is " + text_of(given) + ", must be finite, at most 3.4e38");
  }
  return v;
}

/// What a sequence of Python has.
inline std::vector<nb::object> items_of(nb::handle given, std::string const& name) {
  nb::object const all = nb::steal(PyObject_GetIter(given.ptr()));
  if (!all.is_valid()) {
    PyErr_Clear();
    throw argument_error(name + " is " + text_of(given) + ", must be a sequence of numbers");
  }
  std::vector<nb::object> items;
  while (true) {
    nb::object item = nb::steal(PyIter_Next(all.ptr()));
    if (!item.is_valid()) { break; }
    items.push_back(std::move(item));
  }
  if (PyErr_Occurred() != nullptr) { throw nb::python_error(); }
  return items;
}

inline std::vector<double> numbers(nb::handle given, std::string const& name) {
  std::vector<double> all;
  for (nb::object const& item : items_of(given, name)) {
    all.push_back(number(item, name + "[" + std::to_string(all.size()) + "]"));
  }
  return all;
}

inline std::vector<std::int64_t> times(nb::handle given, std::string const& name) {
  std::vector<std::int64_t> all;
  for (nb::object const& item : items_of(given, name)) {
    all.push_back(nanoseconds(item, name + "[" + std::to_string(all.size()) + "]"));
  }
  return all;
}

/// fx, fy, cx, cy and what follows of a camera model, of a sequence of them or of a matrix (3, 3).
inline std::vector<double> camera_values(nb::handle given, std::string const& name) {
  nb::object const of =
      nb::hasattr(given, "parameters") ? nb::object(given.attr("parameters")) : nb::borrow(given);
  std::vector<nb::object> const rows = items_of(of, name);
  bool const is_matrix =
      !rows.empty() && nb::hasattr(rows[0], "__len__") && !nb::isinstance<nb::str>(rows[0]);
  if (!is_matrix) { return numbers(of, name); }
  std::vector<double> K;
  bool square = rows.size() == 3;
  for (nb::object const& row : rows) {
    std::vector<double> const values = numbers(row, name);
    square = square && values.size() == 3;
    K.insert(K.end(), values.begin(), values.end());
  }
  if (!square || K[1] != 0 || K[3] != 0 || K[6] != 0 || K[7] != 0 || K[8] != 1) {
    throw argument_error(name +
                         " is no sequence of numbers, and no matrix (3, 3) with the rows fx 0 cx, "
                         "0 fy cy and 0 0 1");
  }
  return {K[0], K[4], K[2], K[5]};
}

}  // namespace ftpy
