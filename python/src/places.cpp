// SPDX-License-Identifier: Apache-2.0
#include <cstring>
#include <limits>
#include <map>

#include "ft/containers/vocabulary_text.hpp"
#include "ft/pipelines/place_recognition.hpp"
#include "python/src/conversions.hpp"

namespace ftpy::FTPY_DEVICE {
namespace {

class places_of final : public places, private executor {
public:
  explicit places_of(place_options const& o)
      : executor(0), frames_(o.features, 1), counts_(1), room_(o.features) {
    ft::place_params p;
    p.keyframes = o.keyframes;
    p.features = o.features;
    p.levels_up = o.levels_up;
    inner_ = ft::place_recognition<exec_type>(
        exec, ft::upload(exec, ft::read_vocabulary(o.vocabulary).view()), p);
  }
  void describe(std::uint8_t const* descriptors, int n) override {
    if (n > room_) {
      throw argument_error(std::to_string(n) + " descriptors, the limit is " +
                           std::to_string(room_) + " (features)");
    }
    translated([&] {
      auto const bytes = static_cast<std::size_t>(n) * sizeof(ft::descriptor);
      ft::buffer<ft::descriptor, ft::staging_space<exec_type>> const given(
          static_cast<std::size_t>(n > 0 ? n : 1));
      if (n > 0) { std::memcpy(given.data(), descriptors, bytes); }
      *counts_.data() = n;
      ft::keypoints_view const to = frames_.view();
      ft::copy(exec, ft::array_of<ft::field::orb>(to),
               static_cast<ft::descriptor const*>(given.data()), static_cast<std::size_t>(n));
      ft::copy(exec, to.count, static_cast<int const*>(counts_.data()), std::size_t{1});
      inner_.describe(exec, to);
      exec.wait();
    });
  }
  std::int64_t add(int map) override {
    return translated([&] {
      ft::keyframe_id const id = inner_.add(exec, 0, map);
      ids_[id.number] = id;
      return static_cast<std::int64_t>(id.number);
    });
  }
  void erase(std::int64_t keyframe) override {
    bool const fits = keyframe >= 0 && keyframe <= std::numeric_limits<std::uint32_t>::max();
    auto const found = fits ? ids_.find(static_cast<std::uint32_t>(keyframe)) : ids_.end();
    if (found == ids_.end()) {
      throw argument_error("there is no keyframe " + std::to_string(keyframe));
    }
    translated([&] { inner_.erase(exec, found->second); });
    ids_.erase(found);
  }
  std::vector<place> query(int map) override {
    return translated([&] {
      int const maps[1] = {map};
      inner_.query(exec, {maps, 1});
      std::vector<place> all;
      for (ft::place_candidate const& c : inner_.download(exec)) {
        all.push_back({static_cast<std::int64_t>(c.keyframe.number), static_cast<double>(c.score)});
      }
      return all;
    });
  }
  std::vector<std::pair<std::uint32_t, double>> words() const override {
    ft::frame_words_view const w = inner_.words();
    int n = 0;
    ft::copy(exec, &n, static_cast<int const*>(w.bag.count), std::size_t{1});
    exec.wait();
    std::vector<std::uint32_t> word(static_cast<std::size_t>(n));
    std::vector<double> weight(word.size());
    ft::copy(exec, word.data(), static_cast<std::uint32_t const*>(w.bag.word), word.size());
    ft::copy(exec, weight.data(), static_cast<double const*>(w.bag.value), weight.size());
    exec.wait();
    std::vector<std::pair<std::uint32_t, double>> all;
    for (std::size_t i = 0; i < word.size(); ++i) { all.emplace_back(word[i], weight[i]); }
    return all;
  }
  int size() const override { return inner_.size(); }

private:
  ft::keypoints<exec_type::space> frames_;
  ft::buffer<int, ft::staging_space<exec_type>> counts_;
  int room_;
  ft::place_recognition<exec_type> inner_;
  std::map<std::uint32_t, ft::keyframe_id> ids_;
};

}  // namespace

std::unique_ptr<places> make_places(place_options const& o) {
  return translated([&]() -> std::unique_ptr<places> { return std::make_unique<places_of>(o); });
}

}  // namespace ftpy::FTPY_DEVICE
