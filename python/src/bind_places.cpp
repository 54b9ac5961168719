// SPDX-License-Identifier: Apache-2.0
#include "python/src/arrays.hpp"

namespace ftpy {
namespace {

class bound_places {
public:
  bound_places(std::string const& vocabulary, int keyframes, int features, int levels_up,
               std::string const& device) {
    bool const gpu = on_gpu(device);
    place_options const o{vocabulary, keyframes, features, levels_up};
    nb::gil_scoped_release const released;
    inner_ = gpu ? cuda::make_places(o) : host::make_places(o);
  }
  void describe(nb::handle descriptors) {
    arrays kept;
    image const v = kept.gray(descriptors, "descriptors");
    if (v.width != 32 || v.stride != 32) {
      throw argument_error("descriptors must have 32 bytes each: shape (n, 32), without gaps");
    }
    nb::gil_scoped_release const released;
    inner_->describe(v.data, v.height);
  }
  std::int64_t add(int map) { return inner_->add(map); }
  void erase(std::int64_t keyframe) { inner_->erase(keyframe); }
  nb::list query(int map) {
    std::vector<place> found;
    {
      nb::gil_scoped_release const released;
      found = inner_->query(map);
    }
    nb::list out;
    for (place const& p : found) { out.append(nb::make_tuple(p.keyframe, p.score)); }
    return out;
  }
  nb::dict words() const {
    nb::dict d;
    for (auto const& [word, weight] : inner_->words()) { d[nb::int_(word)] = weight; }
    return d;
  }
  int size() const { return inner_->size(); }

private:
  std::unique_ptr<places> inner_;
};

}  // namespace

void bind_places(nb::module_& m) {
  nb::class_<bound_places>(m, "PlaceRecognition",
                           "Finds keyframes that show the same place as a frame, by the words of a "
                           "vocabulary (DBoW2's text form, or ft's binary one).")
      .def(nb::init<std::string const&, int, int, int, std::string const&>(), nb::arg("vocabulary"),
           nb::arg("keyframes") = 5000, nb::arg("features") = 2000, nb::arg("levels_up") = 4,
           nb::arg("device") = "auto")
      .def("describe", &bound_places::describe, nb::arg("descriptors"),
           "Transforms the descriptors of a frame, (n, 32) uint8, into words. They are the frame "
           "of the next add() or query().")
      .def("add", &bound_places::add, nb::arg("map") = 0,
           "Adds the frame as a keyframe, and returns its number.")
      .def("erase", &bound_places::erase, nb::arg("keyframe"))
      .def("query", &bound_places::query, nb::arg("map") = 0,
           "Keyframes that may show the place of the frame: (number, score), the order is that of "
           "the database.")
      .def("words", &bound_places::words, "Words of the frame and their weights.")
      .def("__len__", &bound_places::size);
}

}  // namespace ftpy
