// SPDX-License-Identifier: Apache-2.0
#include <nanobind/stl/vector.h>

#include <cstring>
#include <type_traits>

#include "ft/cameras/double_sphere.hpp"
#include "ft/cameras/field_of_view.hpp"
#include "ft/cameras/kannala_brandt.hpp"
#include "ft/cameras/pinhole.hpp"
#include "ft/cameras/radtan.hpp"
#include "ft/cameras/unified.hpp"
#include "python/src/arrays.hpp"

namespace ftpy {
namespace {

std::size_t rows_of(arrays& kept, any_array const& a, nb::handle given, std::string const& name,
                    std::size_t columns, double const*& data) {
  if (a.ndim() != 2) {
    throw argument_error(name + " must be a float64 array of shape (n, " + std::to_string(columns) +
                         ")");
  }
  data = kept.doubles(given, name, {a.shape(0), columns});
  return a.shape(0);
}

/// A model, in double. Its parameters are consecutive.
template <template <typename> class Model>
struct bound_camera {
  using camera = Model<double>;
  static constexpr std::size_t values = sizeof(camera) / sizeof(double);

  static void bind(nb::module_& m, char const* name, char const* doc) {
    nb::class_<bound_camera>(m, name, doc)
        .def(nb::init<nb::handle, nb::handle>(), nb::arg("parameters").none(),
             nb::arg("distortion").none() = nb::none())
        .def_prop_ro("parameters", [](bound_camera const& c) { return c.parameters(); })
        .def("__reduce__",
             [](nb::handle self) {  // rigs go to other processes
               return nb::make_tuple(self.type(), nb::make_tuple(self.attr("parameters")));
             })
        .def("project", &bound_camera::project, nb::arg("points").none(),
             "Pixels (n, 2) of points (n, 3) in the camera's frame, and which of them are valid.")
        .def("unproject", &bound_camera::unproject, nb::arg("pixels").none(),
             "Rays (n, 3) with z = 1 or unit length, by model, of pixels (n, 2), and which of them "
             "are valid.");
  }

  /// @param parameters all of them, or a matrix (3, 3) @param distortion those that follow, of any
  ///   shape
  bound_camera(nb::handle parameters, nb::handle distortion) {
    std::vector<double> given = camera_values(parameters, "parameters");
    if (!distortion.is_none()) {
      nb::object const flat = nb::module_::import_("numpy").attr("ravel")(distortion);
      std::vector<double> const more = numbers(flat, "distortion");
      given.insert(given.end(), more.begin(), more.end());
    }
    if (std::is_same_v<camera, ft::radtan8<double>>) { complete_radtan(given, "RadTan"); }
    if (given.size() != values) {
      throw argument_error(std::to_string(given.size()) + " parameters, must be " +
                           std::to_string(values));
    }
    std::memcpy(&of, given.data(), sizeof of);
    of.check();
  }
  std::vector<double> parameters() const {
    std::vector<double> v(values);
    std::memcpy(v.data(), &of, sizeof of);
    return v;
  }
  nb::object project(nb::handle points) const {
    arrays kept;
    double const* p = nullptr;
    std::size_t const n = rows_of(kept, kept.take(points, "points"), points, "points", 3, p);
    std::vector<double> pixel;
    std::vector<std::uint8_t> valid;
    for (std::size_t i = 0; i < n; ++i, p += 3) {
      auto const at = of.project({p[0], p[1], p[2]});
      pixel.insert(pixel.end(), {at.pixel.x, at.pixel.y});
      valid.push_back(at.valid ? 1 : 0);
    }
    return nb::make_tuple(to_numpy(std::move(pixel), {n, 2}),
                          to_numpy(std::move(valid)).attr("astype")("bool"));
  }
  nb::object unproject(nb::handle pixels) const {
    arrays kept;
    double const* p = nullptr;
    std::size_t const n = rows_of(kept, kept.take(pixels, "pixels"), pixels, "pixels", 2, p);
    std::vector<double> ray;
    std::vector<std::uint8_t> valid;
    for (std::size_t i = 0; i < n; ++i, p += 2) {
      auto const r = of.unproject({p[0], p[1]});
      ray.insert(ray.end(), {r.direction.x, r.direction.y, r.direction.z});
      valid.push_back(r.valid ? 1 : 0);
    }
    return nb::make_tuple(to_numpy(std::move(ray), {n, 3}),
                          to_numpy(std::move(valid)).attr("astype")("bool"));
  }

  camera of;
};

}  // namespace

void bind_cameras(nb::module_& m) {
  m.def("camera_values", camera_values, nb::arg("camera").none(), nb::arg("name"),
        "Parameters of a model, of a sequence of them, or of a matrix (3, 3): fx, fy, cx, cy ...");
  bound_camera<ft::pinhole>::bind(m, "Pinhole",
                                  "Parameters fx, fy, cx, cy, pixels, or a matrix (3, 3). As for "
                                  "all models, `distortion` are those that follow, an array of any "
                                  "shape.");
  bound_camera<ft::radtan8>::bind(m, "RadTan",
                                  "Radial-tangential distortion: fx, fy, cx, cy, k1, k2, p1, p2, "
                                  "k3, k4, k5, k6, as OpenCV orders them; with 0, 4, 5 or 8 "
                                  "coefficients, the others are 0.");
  bound_camera<ft::kannala_brandt>::bind(m, "KannalaBrandt",
                                         "Fisheye: fx, fy, cx, cy, k1, k2, k3, k4.");
  bound_camera<ft::double_sphere>::bind(m, "DoubleSphere", "fx, fy, cx, cy, xi, alpha.");
  bound_camera<ft::unified>::bind(m, "Unified", "fx, fy, cx, cy, xi, k1, k2, p1, p2.");
  bound_camera<ft::extended_unified>::bind(m, "ExtendedUnified", "fx, fy, cx, cy, alpha, beta.");
  bound_camera<ft::field_of_view>::bind(m, "FieldOfView", "fx, fy, cx, cy, w.");
}

}  // namespace ftpy
