// SPDX-License-Identifier: Apache-2.0
#include "python/src/arrays.hpp"

namespace ftpy {
namespace {

class bound_places {
public:
  bound_places(nb::handle vocabulary, nb::handle keyframes, nb::handle features,
               nb::handle levels_up, std::string const& device) {
    bool const gpu = on_gpu(device);
    place_options const o{nb::cast<std::string>(nb::str(vocabulary)), whole(keyframes, "keyframes"),
                          whole(features, "features"), whole(levels_up, "levels_up")};
    nb::gil_scoped_release const released;
    inner_ = gpu ? cuda::make_places(o) : host::make_places(o);
  }
  void describe(nb::handle descriptors) {
    arrays kept;
    int n = 0;
    auto const* const first =
        static_cast<std::uint8_t const*>(kept.rows_of_bytes(descriptors, "descriptors", 32, n));
    nb::gil_scoped_release const released;
    inner_->describe(first, n);
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
  owned<places> inner_;
};

}  // namespace

void bind_places(nb::module_& m) {
  nb::class_<bound_places>(m, "PlaceRecognition",
                           "Finds keyframes that show the same place as a frame, by the words of a "
                           "vocabulary (DBoW2's text form, or ft's binary one).")
      .def(nb::init<nb::handle, nb::handle, nb::handle, nb::handle, std::string const&>(),
           nb::arg("vocabulary").none(), nb::arg("keyframes").none() = 5000,
           nb::arg("features").none() = 2000, nb::arg("levels_up").none() = 4,
           nb::arg("device") = "auto")
      .def("describe", &bound_places::describe, nb::arg("descriptors").none(),
           "Transforms the descriptors of a frame, (n, 32) uint8, n may be 0, into words. They are "
           "the frame of the next add() or query().")
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
