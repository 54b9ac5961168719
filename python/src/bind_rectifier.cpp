// SPDX-License-Identifier: Apache-2.0
#include "python/src/arrays.hpp"

namespace ftpy {
namespace {

class bound_rectifier {
public:
  bound_rectifier(nb::handle of, nb::handle width, nb::handle height, nb::handle border,
                  nb::handle threads, std::string const& device)
      : width_(whole(width, "width")), height_(whole(height, "height")), gpu_(on_gpu(device)) {
    rig const r = rig_of(of);
    border_ = static_cast<std::uint8_t>(whole(border, "border", 0, 255));
    given_width_ = r.raw_width > 0 ? r.raw_width : width_;
    given_height_ = r.raw_height > 0 ? r.raw_height : height_;
    int const n = whole(threads, "threads");
    nb::gil_scoped_release const released;
    inner_ = gpu_ ? cuda::make_rectifier(r, width_, height_, n)
                  : host::make_rectifier(r, width_, height_, n);
  }

  nb::object rectify(nb::handle left, nb::handle right, nb::handle out, std::uintptr_t stream) {
    if (!out.is_none() && (!nb::hasattr(out, "__len__") || nb::len(out) != 2)) {
      throw argument_error("out is " + text_of(out) + ", must be two arrays");
    }
    arrays kept(gpu_);
    image const given[2] = {taken(kept, left, "the left image"),
                            taken(kept, right, "the right image")};
    bool const on_device = kept.on_device();
    nb::object made[2];
    rectified_image to[2];
    for (std::size_t i = 0; i < 2; ++i) {
      if (out.is_none()) {
        made[i] = on_device ? on_the_device(to[i]) : on_the_host(to[i]);
      } else {
        made[i] = nb::borrow(out[i]);
        to[i] = kept.written(made[i], i == 0 ? "out[0]" : "out[1]", width_, height_);
      }
    }
    {
      nb::gil_scoped_release const released;
      if (kept.on_device()) { inner_->wait_for(stream); }
      inner_->rectify(given, to, border_);
    }
    return nb::make_tuple(made[0], made[1]);
  }
  nb::object map(int camera) const {
    if (camera != 0 && camera != 1) {
      throw argument_error("camera is " + std::to_string(camera) + ", must be 0 or 1");
    }
    rectification r = inner_->map(camera);
    auto const h = static_cast<std::size_t>(height_);
    auto const w = static_cast<std::size_t>(width_);
    return nb::make_tuple(to_numpy(std::move(r.position), {h, w, 2}),
                          to_numpy(std::move(r.fraction), {h, w}),
                          to_numpy(std::vector<double>(r.R.begin(), r.R.end()), {3, 3}));
  }
  double baseline() const { return inner_->baseline(); }

private:
  image taken(arrays& kept, nb::handle given, std::string const& name) const {
    image const v = kept.gray(given, name);
    if (v.width != given_width_ || v.height != given_height_) {
      throw argument_error(name + " has shape (" + std::to_string(v.height) + ", " +
                           std::to_string(v.width) + "), must have (" +
                           std::to_string(given_height_) + ", " + std::to_string(given_width_) +
                           ")");
    }
    return v;
  }
  nb::object on_the_host(rectified_image& to) const {
    auto const h = static_cast<std::size_t>(height_);
    auto const w = static_cast<std::size_t>(width_);
    std::vector<std::uint8_t> pixels(w * h);
    to = {pixels.data(), width_};  // which stays where it is when the vector is moved
    return to_numpy(std::move(pixels), {h, w});
  }
  nb::object on_the_device(rectified_image& to) const {
    auto* const owned = new std::shared_ptr<std::uint8_t>(inner_->make_image());
    to = {owned->get(), width_};
    nb::capsule const owner(
        owned, [](void* p) noexcept { delete static_cast<std::shared_ptr<std::uint8_t>*>(p); });
    std::size_t const shape[2] = {static_cast<std::size_t>(height_),
                                  static_cast<std::size_t>(width_)};
    return nb::cast(nb::ndarray<std::uint8_t>(owned->get(), 2, shape, owner, nullptr,
                                              nb::dtype<std::uint8_t>(), nb::device::cuda::value,
                                              inner_->device()));
  }

  owned<rectifier> inner_;
  int width_, height_;
  int given_width_ = 0, given_height_ = 0;
  std::uint8_t border_ = 0;
  bool gpu_;
};

}  // namespace

void bind_rectifier(nb::module_& m) {
  nb::class_<bound_rectifier>(m, "RectificationPipeline", "See ft.Rectifier.")
      .def(nb::init<nb::handle, nb::handle, nb::handle, nb::handle, nb::handle,
                    std::string const&>(),
           nb::arg("rig").none(), nb::arg("width").none(), nb::arg("height").none(),
           nb::arg("border").none(), nb::arg("threads").none(), nb::arg("device"))
      .def("rectify", &bound_rectifier::rectify, nb::arg("left").none(), nb::arg("right").none(),
           nb::arg("out").none(), nb::arg("stream") = 0)
      .def("map", &bound_rectifier::map, nb::arg("camera"))
      .def_prop_ro("baseline", &bound_rectifier::baseline);
}

}  // namespace ftpy
