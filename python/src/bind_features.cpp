// SPDX-License-Identifier: Apache-2.0
#include "python/src/arrays.hpp"

namespace ftpy {
namespace {

nb::dict to_dict(keypoint_arrays k) {
  std::size_t const n = k.x.size();
  nb::dict d;
  d["x"] = to_numpy(std::move(k.x));
  d["y"] = to_numpy(std::move(k.y));
  d["angle"] = to_numpy(std::move(k.angle));
  d["response"] = to_numpy(std::move(k.response));
  d["octave"] = to_numpy(std::move(k.octave));
  d["descriptors"] = to_numpy(std::move(k.descriptors), {n, 32});
  return d;
}

/// An extractor, with a rig also a stereo matcher.
class feature_pipeline {
public:
  feature_pipeline(nb::handle options, nb::handle batch, nb::handle of, std::string const& device) {
    feature_options const o = feature_options_of(options);
    width_ = o.width;
    height_ = o.height;
    bool const gpu = gpu_ = on_gpu(device);
    rig const r = of.is_none() ? rig{} : rig_of(of);
    int const n = batch_ = whole(batch, "batch");
    nb::gil_scoped_release const released;
    inner_ = gpu ? cuda::make_features(o, n, r) : host::make_features(o, n, r);
  }
  void set_mask(int i, nb::handle mask) {
    arrays kept;
    image const v = kept.mask(mask, "mask");
    nb::gil_scoped_release const released;
    inner_->set_mask(i, v);
  }
  nb::list extract(nb::sequence const& given, std::uintptr_t stream) {
    arrays kept(gpu_);
    std::vector<image> const images = images_of(kept, given);
    std::vector<keypoint_arrays> found;
    {
      nb::gil_scoped_release const released;
      if (kept.on_device()) { inner_->wait_for(stream); }
      found = inner_->extract(images);
    }
    nb::list out;
    for (auto& k : found) { out.append(to_dict(std::move(k))); }
    return out;
  }
  nb::list match(nb::sequence const& given, std::uintptr_t stream) {
    arrays kept(gpu_);
    std::vector<image> const images = images_of(kept, given);
    std::vector<stereo_arrays> found;
    {
      nb::gil_scoped_release const released;
      if (kept.on_device()) { inner_->wait_for(stream); }
      found = inner_->match(images);
    }
    nb::list out;
    for (auto& s : found) {
      nb::object right_x = to_numpy(std::move(s.right_x));
      nb::object depth = to_numpy(std::move(s.depth));
      out.append(
          nb::make_tuple(to_dict(std::move(s.left)), to_dict(std::move(s.right)), right_x, depth));
    }
    return out;
  }
  int capacity() const { return inner_->capacity(); }

private:
  std::vector<image> images_of(arrays& kept, nb::sequence const& given) const {
    std::vector<image> images;
    for (nb::handle const h : given) {
      std::string const name = "image " + std::to_string(images.size());
      image const v = kept.gray(h, name);
      if (v.width != width_ || v.height != height_) {
        throw argument_error(name + " has shape (" + std::to_string(v.height) + ", " +
                             std::to_string(v.width) + "), must have (" + std::to_string(height_) +
                             ", " + std::to_string(width_) + ")");
      }
      images.push_back(v);
    }
    if (static_cast<int>(images.size()) != batch_) {
      throw argument_error(std::to_string(images.size()) + " images, must be " +
                           std::to_string(batch_));
    }
    return images;
  }

  owned<features> inner_;
  int width_ = 0, height_ = 0, batch_ = 0;
  bool gpu_ = false;
};

}  // namespace

void bind_features(nb::module_& m) {
  nb::class_<feature_pipeline>(m, "FeaturePipeline", "See ft.OrbExtractor and ft.StereoMatcher.")
      .def(nb::init<nb::handle, nb::handle, nb::handle, std::string const&>(),
           nb::arg("options").none(), nb::arg("batch").none(), nb::arg("rig").none(),
           nb::arg("device"))
      .def("set_mask", &feature_pipeline::set_mask, nb::arg("i"), nb::arg("mask").none())
      .def("extract", &feature_pipeline::extract, nb::arg("images"), nb::arg("stream") = 0)
      .def("match", &feature_pipeline::match, nb::arg("images"), nb::arg("stream") = 0)
      .def_prop_ro("capacity", &feature_pipeline::capacity);
}

}  // namespace ftpy
