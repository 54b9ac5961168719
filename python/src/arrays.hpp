// SPDX-License-Identifier: Apache-2.0
/// @file Arrays of Python as plain views, and back.
#pragma once

#include <nanobind/nanobind.h>
#include <nanobind/ndarray.h>
#include <nanobind/stl/string.h>

#include <unistd.h>

#include <cmath>
#include <cstddef>
#include <cstdint>
#include <initializer_list>
#include <limits>
#include <memory>
#include <stdexcept>
#include <string>
#include <utility>
#include <vector>

#include "ft/any_odometry.hpp"
#include "python/src/api.hpp"
#include "python/src/numbers.hpp"

namespace ftpy {

using any_array = nb::ndarray<nb::ro>;

/// A pipeline. A process that was forked has none of its threads: there it is not called, and left
/// where it is.
template <typename T>
class owned {
public:
  owned() = default;
  owned(owned const&) = delete;
  owned& operator=(owned const&) = delete;
  owned& operator=(std::unique_ptr<T> made) {
    of_ = std::move(made);
    return *this;
  }
  ~owned() {
    if (getpid() != process_) { static_cast<void>(of_.release()); }
  }
  T* operator->() const {
    if (getpid() != process_) {
      throw std::runtime_error(
          "this object was made before os.fork(), and its threads are the parent's: make one in "
          "the child, or start the child with multiprocessing.get_context('spawn')");
    }
    return of_.get();
  }

private:
  std::unique_ptr<T> of_;
  pid_t process_ = getpid();
};

/// Keeps the arrays of a call.
class arrays {
public:
  /// @param gpu whether images may lie on the device
  explicit arrays(bool gpu = false) : gpu_(gpu) {}
  bool on_device() const { return on_device_; }  ///< whether one of them does

  /// @param there on the device @throws argument_error naming what is wrong with it
  any_array take(nb::handle given, std::string const& name, bool there = false) {
    any_array a;
    if (given.is_none() || !nb::try_cast(given, a)) {
      throw argument_error(name + " is not an array: it must be a NumPy array, or have __dlpack__");
    }
    kept_.push_back(a);
    if (there) { require_place(a, name); }
    return a;
  }
  image gray(nb::handle given, std::string const& name) { return bytes(given, name, false); }
  /// As gray(), or what a comparison gives: bool.
  image mask(nb::handle given, std::string const& name) { return bytes(given, name, true); }
  /// Of n rows, which may be none, without gaps. @return the first one, and n in `rows`
  /// @param is_signed int8 in place of uint8 @param there on the device
  void const* rows_of_bytes(nb::handle given, std::string const& name, int columns, int& rows,
                            bool is_signed = false, bool there = false) {
    any_array const a = take(given, name, there);
    bool const fits =
        a.ndim() == 2 &&
        a.dtype() == (is_signed ? nb::dtype<std::int8_t>() : nb::dtype<std::uint8_t>()) &&
        a.shape(1) == static_cast<std::size_t>(columns) &&
        (a.shape(0) < 2 || a.stride(0) == columns) && (a.shape(0) < 1 || a.stride(1) == 1);
    if (!fits || !lies(a, there)) {
      throw argument_error(name + " must be a" + (is_signed ? "n int8" : " uint8") +
                           " array of shape (n, " + std::to_string(columns) +
                           ") without gaps, on " + place_name(there));
    }
    rows = length(static_cast<std::int64_t>(a.shape(0)), name, "number of rows");
    return a.data();
  }
  /// Of a given size, which can be written.
  rectified_image written(nb::handle given, std::string const& name, int width, int height) {
    nb::ndarray<> a;
    if (given.is_none() || !nb::try_cast(given, a)) {
      throw argument_error(name + " is not an array that can be written");
    }
    image const v = gray(given, name);
    if (v.width != width || v.height != height) {
      throw argument_error(name + " has shape (" + std::to_string(v.height) + ", " +
                           std::to_string(v.width) + "), must have (" + std::to_string(height) +
                           ", " + std::to_string(width) + ")");
    }
    return {static_cast<std::uint8_t*>(a.data()), v.stride};
  }
  depth_image depth(nb::handle given, std::string const& name) {
    any_array const a = take(given, name);
    bool const is_float = a.dtype() == nb::dtype<float>();
    if (a.ndim() != 2) { throw argument_error(name + " must have 2 dimensions (rows, columns)"); }
    if (!is_float && a.dtype() != nb::dtype<std::uint16_t>()) {
      throw argument_error(name + " has another type than uint16 and float32");
    }
    require_rows(a, name);
    require_place(a, name);
    auto const bytes =
        static_cast<std::ptrdiff_t>(is_float ? sizeof(float) : sizeof(std::uint16_t));
    auto const row = static_cast<std::ptrdiff_t>(
        a.shape(0) > 1 ? a.stride(0) : static_cast<std::int64_t>(a.shape(1)));
    return {a.data(), columns_of(a, name), rows_of(a, name), row * bytes, is_float};
  }
  /// Of doubles, one after the other. @param shape what it must have
  double const* doubles(nb::handle given, std::string const& name,
                        std::initializer_list<std::size_t> shape) {
    return numbers<double>(given, name, "float64", shape);
  }
  /// The same of any type. @param type its name @param there on the device
  template <typename T>
  T const* numbers(nb::handle given, std::string const& name, char const* type,
                   std::initializer_list<std::size_t> shape, bool there = false) {
    any_array const a = take(given, name, there);
    bool same = a.ndim() == shape.size() && a.dtype() == nb::dtype<T>();
    std::size_t n = 1;
    std::size_t i = 0;
    for (std::size_t const s : shape) {
      same = same && a.shape(i) == s;
      n *= s;
      ++i;
    }
    std::int64_t step = static_cast<std::int64_t>(n);
    for (i = 0; same && n > 0 && i < a.ndim(); ++i) {  // without elements there are no steps
      step /= static_cast<std::int64_t>(a.shape(i));
      same = a.stride(i) == step || a.shape(i) == 1;
    }
    if (!same || !lies(a, there)) {
      std::string text;
      for (std::size_t const s : shape) { text += (text.empty() ? "" : ", ") + std::to_string(s); }
      throw argument_error(name + " must be a " + type + " array of shape (" + text +
                           ") without gaps, on " + place_name(there));
    }
    return static_cast<T const*>(a.data());
  }
  /// An image that a graph reads in place if it is on the device.
  image framed(nb::handle given, std::string const& name) {
    bool const before = on_device_;
    on_device_ = false;
    image const v = gray(given, name);
    bool const aligned = reinterpret_cast<std::uintptr_t>(v.data) % 16 == 0 && v.stride % 16 == 0 &&
                         v.width % 16 == 0;
    if (on_device_ && !aligned) {
      throw argument_error(name +
                           " on the device needs an address, a width and a distance of rows "
                           "that are multiples of 16");
    }
    on_device_ = on_device_ || before;
    return v;
  }
  pose matrix(nb::handle given, std::string const& name) {
    double const* const from = doubles(given, name, {4, 4});
    pose m;
    for (std::size_t i = 0; i < 16; ++i) {
      m[i] = from[i];
      if (!(std::abs(m[i]) <= static_cast<double>(std::numeric_limits<float>::max()))) {
        throw argument_error(name + "[" + std::to_string(i / 4) + ", " + std::to_string(i % 4) +
                             "] is " + std::to_string(m[i]) + ", must be finite, at most 3.4e38");
      }
    }
    if (m[12] != 0 || m[13] != 0 || m[14] != 0 || m[15] != 1) {
      throw argument_error(name + " is no rigid motion: its last row must be 0 0 0 1");
    }
    return m;
  }

private:
  static bool lies(any_array const& a, bool there) {
    return a.device_type() == (there ? nb::device::cuda::value : nb::device::cpu::value);
  }
  static char const* place_name(bool there) { return there ? "the GPU" : "the host"; }
  /// The call that makes a grey image of one with channels.
  static std::string mend_of_shape(any_array const& a) {
    if (a.ndim() != 3) { return {}; }
    std::size_t const channels = a.shape(2);
    if (channels == 1) { return ": image[:, :, 0] has them"; }
    if (channels != 3 && channels != 4) { return {}; }
    return std::string(": cv2.cvtColor(image, cv2.COLOR_") + (channels == 3 ? "BGR" : "BGRA") +
           "2GRAY) makes a colour image grey";
  }
  /// The call that makes bytes of numbers.
  static std::string mend_of_type(any_array const& a) {
    if (a.dtype().code == static_cast<std::uint8_t>(nb::dlpack::dtype_code::Float)) {
      return ": numpy.uint8(image.clip(0, 1) * 255 + 0.5) makes it of numbers from 0 to 1";
    }
    if (a.dtype() == nb::dtype<std::uint16_t>()) {
      return ": numpy.uint8(image >> 8) makes it of 16 bits";
    }
    return {};
  }
  image bytes(nb::handle given, std::string const& name, bool or_bool) {
    any_array const a = take(given, name);
    if (a.ndim() != 2) {
      throw argument_error(name + " has " + std::to_string(a.ndim()) +
                           " dimensions, must have 2 (rows, columns)" + mend_of_shape(a));
    }
    if (a.dtype() != nb::dtype<std::uint8_t>() && !(or_bool && a.dtype() == nb::dtype<bool>())) {
      throw argument_error(name + " has another type than uint8" + (or_bool ? " and bool" : "") +
                           mend_of_type(a));
    }
    require_rows(a, name);
    require_place(a, name);
    std::int64_t const row = a.shape(0) > 1 ? a.stride(0) : static_cast<std::int64_t>(a.shape(1));
    return {static_cast<std::uint8_t const*>(a.data()), columns_of(a, name), rows_of(a, name),
            length(row, name, "distance of rows")};
  }
  static int length(std::int64_t n, std::string const& name, char const* what) {
    if (n > std::numeric_limits<int>::max()) {
      throw argument_error(name + " has a " + what + " of " + std::to_string(n) +
                           ", must be at most " + std::to_string(std::numeric_limits<int>::max()));
    }
    return static_cast<int>(n);
  }
  static int rows_of(any_array const& a, std::string const& name) {
    return length(static_cast<std::int64_t>(a.shape(0)), name, "height");
  }
  static int columns_of(any_array const& a, std::string const& name) {
    return length(static_cast<std::int64_t>(a.shape(1)), name, "width");
  }
  static void require_rows(any_array const& a, std::string const& name) {
    if (a.shape(0) == 0 || a.shape(1) == 0) {
      throw argument_error(name + " is empty: its shape is (" + std::to_string(a.shape(0)) + ", " +
                           std::to_string(a.shape(1)) + ")");
    }
    bool const columns = a.shape(1) == 1 || a.stride(1) == 1;
    bool const rows = a.shape(0) == 1 || a.stride(0) >= static_cast<std::int64_t>(a.shape(1));
    if (!columns || !rows) {
      throw argument_error(name +
                           " has pixels of a row that are not next to each other, or rows "
                           "that overlap: numpy.ascontiguousarray() helps");
    }
  }
  void require_place(any_array const& a, std::string const& name) {
    if (a.device_type() == nb::device::cpu::value) { return; }
    if (!gpu_ || a.device_type() != nb::device::cuda::value) {
      throw argument_error(name + " is not in host memory, where this object works");
    }
    on_device_ = true;
  }

  bool gpu_;
  bool on_device_ = false;
  std::vector<any_array> kept_;
};

/// A NumPy array that owns the numbers.
template <typename T>
nb::object to_numpy(std::vector<T> values, std::initializer_list<std::size_t> shape) {
  auto* const kept = new std::vector<T>(std::move(values));
  kept->reserve(1);  // an array of nothing has an address, too
  nb::capsule const owner(kept, [](void* p) noexcept { delete static_cast<std::vector<T>*>(p); });
  std::vector<std::size_t> const sizes(shape);
  return nb::cast(nb::ndarray<nb::numpy, T>(kept->data(), sizes.size(), sizes.data(), owner));
}
template <typename T>
nb::object to_numpy(std::vector<T> values) {
  std::size_t const n = values.size();
  return to_numpy(std::move(values), {n});
}
inline nb::object to_numpy(pose const& m) {
  return to_numpy(std::vector<double>(m.begin(), m.end()), {4, 4});
}
inline nb::object to_numpy(ft::vec3<double> const& v) {
  return to_numpy(std::vector<double>{v.x, v.y, v.z});
}

void bind_features(nb::module_& m);
void bind_odometry(nb::module_& m);
void bind_tracking(nb::module_& m);
void bind_places(nb::module_& m);
void bind_rectifier(nb::module_& m);
void bind_reports(nb::module_& m);
void bind_sequences(nb::module_& m);
void bind_calibration(nb::module_& m);
void bind_cameras(nb::module_& m);

/// The rig of a rig object of ft.rigs.
rig rig_of(nb::handle given);
/// What the images of a frame of a rig are called.
std::vector<std::string> image_names(rig const& of);
/// @param options a dict of ft.features
feature_options feature_options_of(nb::handle options);

/// Whether `device`, "auto", "host" or "cuda", is a GPU.
inline bool on_gpu(std::string const& device) {
  if (device != "auto" && device != "host" && device != "cuda") {
    throw argument_error("device is '" + device + "', must be auto, host or cuda");
  }
  bool const there = device != "host" && !ft::gpu_names().empty();
  if (device == "cuda" && !there) {
    throw argument_error("device 'cuda': there is no GPU, or the package was built without CUDA");
  }
  return there;
}

}  // namespace ftpy
