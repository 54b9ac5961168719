// SPDX-License-Identifier: Apache-2.0
#include <nanobind/stl/vector.h>

#include "examples/sequence/types.hpp"
#include "ft/any_odometry.hpp"
#include "ft/core/error.hpp"
#include "ft/types/odometry_params.hpp"
#include "ft/version.hpp"
#include "python/src/arrays.hpp"

namespace ftpy {
namespace {

/// What a message quotes of a file may be no UTF-8.
void raise(PyObject* type, std::string const& text) {
  auto const size = static_cast<Py_ssize_t>(text.size());
  nb::object const said = nb::steal(PyUnicode_DecodeUTF8(text.data(), size, "backslashreplace"));
  if (said.is_valid()) { PyErr_SetObject(type, said.ptr()); }
}

/// Exceptions of C++ as those of Python.
void translate(std::exception_ptr const& p, void*) {
  try {
    std::rethrow_exception(p);
  } catch (argument_error const& e) {
    raise(PyExc_ValueError, e.what());
  } catch (ft::bad_argument const& e) {
    raise(PyExc_ValueError, e.what());
  } catch (ft::error const& e) {
    raise(PyExc_RuntimeError, e.what());
  } catch (seq::error const& e) { raise(PyExc_RuntimeError, e.what()); }
}

std::vector<std::string> devices() {
  std::vector<std::string> all{"host"};
  for (std::string const& name : ft::gpu_names()) { all.push_back("cuda: " + name); }
  return all;
}

/// By the names of Odometry's arguments.
nb::dict defaults() {
  ft::odometry_params const p;
  nb::dict d;
  d["near_depth"] = p.rules.near_depth;
  d["map_slots"] = p.map_slots;
  d["keyframes"] = p.keyframes;
  d["local_points"] = p.local_points;
  d["window"] = nb::make_tuple(p.window.moving, p.window.fixed);
  d["window_points"] = p.window_points;
  d["candidates"] = ft::place_options{}.candidates;
  d["loops"] = p.loops.present;
  d["localize_only"] = p.rules.localize_only;
  d["own_features"] = p.own_features;
  d["measure_stages"] = p.measure_stages;
  d["features"] = p.orb.features;
  d["levels"] = p.orb.levels;
  d["scale_factor"] = p.orb.scale_factor;
  d["ini_threshold"] = p.orb.ini_threshold;
  d["min_threshold"] = p.orb.min_threshold;
  d["corner_ratio"] = p.orb.corner_ratio;
  d["mask_size"] = nb::make_tuple(p.orb.mask_width, p.orb.mask_height);
  d["std_sort"] = p.orb.ties == ft::tie_rule::std_sort;
  return d;
}

}  // namespace
}  // namespace ftpy

NB_MODULE(_ft, m) {
  nanobind::set_leak_warnings(false);  // objects that live as long as the interpreter
  m.doc() = "The extension of the package ft.";
  m.attr("__version__") = std::to_string(ft::version_major) + "." +
                          std::to_string(ft::version_minor) + "." +
                          std::to_string(ft::version_patch);
  nanobind::register_exception_translator(ftpy::translate);
  m.def("devices", ftpy::devices,
        "Where work can run: 'host', and a line 'cuda: NAME' for each GPU that can be used.");
  m.def("defaults", ftpy::defaults, "Of Odometry's arguments, those that C++ has too.");
  ftpy::bind_calibration(m);
  ftpy::bind_cameras(m);
  ftpy::bind_features(m);
  ftpy::bind_odometry(m);
  ftpy::bind_places(m);
  ftpy::bind_rectifier(m);
  ftpy::bind_reports(m);
  ftpy::bind_sequences(m);
}
