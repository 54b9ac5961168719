// SPDX-License-Identifier: Apache-2.0
#include <cstring>

#include "ft/pipelines/stereo_matcher.hpp"
#include "python/src/conversions.hpp"

namespace ftpy::FTPY_DEVICE {
namespace {

template <typename View>
keypoint_arrays copied(View const& k) {
  keypoint_arrays a;
  for (int i = 0; i < *k.count; ++i) {
    a.x.push_back(k.x(i));
    a.y.push_back(k.y(i));
    a.angle.push_back(k.angle(i));
    a.response.push_back(k.response(i));
    a.octave.push_back(k.octave(i));
    ft::descriptor const d = k.orb(i);
    std::uint8_t bytes[sizeof d];
    std::memcpy(bytes, &d, sizeof d);
    a.descriptors.insert(a.descriptors.end(), bytes, bytes + sizeof d);
  }
  return a;
}

/// @tparam Rig that of the pairs, or void
template <typename Rig>
class features_of final : public features, private executor {
public:
  features_of(feature_options const& o, int batch)
      : executor(o.threads), extractor_(exec, orb_params_of(o), batch) {}
  features_of(feature_options const& o, int batch, Rig const& rig,
              std::vector<ft::stereo_overlap> const& overlaps)
      : executor(o.threads),
        extractor_(exec, orb_params_of(o), batch, overlaps),
        matcher_(rig, extractor_),
        matches_(true) {}

  void wait_for(std::uintptr_t stream) override { wait_for_stream(stream); }
  void set_mask(int i, image const& mask) override {
    translated([&] { extractor_.set_mask(exec, i, to_ft(mask)); });
    exec.wait();
  }
  std::vector<keypoint_arrays> extract(std::vector<image> const& images) override {
    return translated([&] {
      run(images);
      auto const all = extractor_.download(exec);
      std::vector<keypoint_arrays> out;
      for (int i = 0; i < extractor_.batch(); ++i) { out.push_back(copied(all.view().slice(i))); }
      return out;
    });
  }
  std::vector<stereo_arrays> match(std::vector<image> const& images) override {
    if (!matches_) { throw argument_error("the extractor was made without a rig"); }
    return translated([&] {
      run(images);
      matcher_.match(exec, extractor_);
      auto const all = extractor_.download(exec);
      auto const n = static_cast<std::size_t>(extractor_.capacity());
      auto const pairs = static_cast<std::size_t>(extractor_.batch() / 2);
      std::vector<float> depth(n * pairs);
      ft::copy(exec, depth.data(), matcher_.depth(), depth.size());
      std::vector<float> right_x(n * pairs, -1.0f);
      std::vector<int> partner(2 * n * pairs, -1);
      if constexpr (Rig::rectified) {
        ft::copy(exec, right_x.data(),
                 static_cast<float const*>(ft::array_of<ft::field::right_x>(matcher_.matches())),
                 right_x.size());
      } else {
        ft::copy(exec, partner.data(), static_cast<int const*>(matcher_.fisheye_matches().partner),
                 partner.size());
      }
      exec.wait();
      std::vector<stereo_arrays> out(pairs);
      for (std::size_t b = 0; b < pairs; ++b) {
        stereo_arrays& s = out[b];
        s.left = copied(all.view().slice(static_cast<int>(2 * b)));
        s.right = copied(all.view().slice(static_cast<int>(2 * b + 1)));
        for (std::size_t i = 0; i < s.left.x.size(); ++i) {
          s.depth.push_back(depth[n * b + i]);
          int const j = partner[2 * n * b + i];
          float const x = j < 0 ? -1.0f : s.right.x[static_cast<std::size_t>(j) - n];
          s.right_x.push_back(Rig::rectified ? right_x[n * b + i] : x);
        }
      }
      return out;
    });
  }
  int capacity() const override { return extractor_.capacity(); }

private:
  void run(std::vector<image> const& images) {
    for (std::size_t i = 0; i < images.size(); ++i) {
      extractor_.upload(exec, static_cast<int>(i), to_ft(images[i]));
    }
    extractor_.extract(exec);
  }

  ft::orb_extractor<exec_type> extractor_;
  ft::stereo_matcher<exec_type, Rig> matcher_;
  bool matches_ = false;
};

}  // namespace

std::unique_ptr<features> make_features(feature_options const& o, int batch, rig const& of) {
  return translated([&]() -> std::unique_ptr<features> {
    if (of.kind.empty()) { return std::make_unique<features_of<ft::rectified_rig>>(o, batch); }
    if (of.kind == "rectified") {
      return std::make_unique<features_of<ft::rectified_rig>>(o, batch, rectified_of(of),
                                                              std::vector<ft::stereo_overlap>{});
    }
    if (of.kind == "fisheye") {
      std::vector<ft::stereo_overlap> const whole(static_cast<std::size_t>(batch), {0, 1e9f});
      return std::make_unique<features_of<kannala_brandt_rig>>(o, batch, fisheye_of(of), whole);
    }
    throw argument_error("stereo needs a rectified pair or two fisheye cameras");
  });
}

}  // namespace ftpy::FTPY_DEVICE
