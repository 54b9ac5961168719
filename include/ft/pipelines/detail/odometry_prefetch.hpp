// SPDX-License-Identifier: Apache-2.0
/// @file Features of images that are given before their frame is tracked.
#pragma once

#include <cstddef>
#include <memory>
#include <utility>
#include <vector>

#include "ft/core/config.hpp"
#include "ft/core/error.hpp"
#include "ft/core/execution.hpp"
#include "ft/core/memory.hpp"
#include "ft/pipelines/detail/frame_features.hpp"
#include "ft/pipelines/detail/work_beside.hpp"
#include "ft/types/odometry_params.hpp"

namespace ft {
inline namespace FT_ABI {
namespace detail {

/// A ring of sets of features. Each set is filled beside the frames that are tracked meanwhile: on
/// a stream of its own, or on a thread. To track a frame, its set and that of the odometry's stages
/// change places.
template <typename Exec, typename Rig>
class odometry_prefetch {
  using features_type = frame_features<Exec, Rig>;
  using images_type = typename rig_parts<Rig>::template input<Exec>::images_type;

public:
  /// Waits. @param stages of the odometry, with all memory
  /// @throws bad_argument, std::bad_alloc, cuda_error
  template <typename Stages>
  odometry_prefetch(Exec const& exec, Rig const& rig, Stages& stages) {
    for (int i = 1; i <= stages.settings.prefetch; ++i) {
      sets_.push_back(std::make_unique<set>(
          exec, features_type(exec, rig, stages.make_extractor(exec, rig_parts<Rig>::absent(rig)),
                              stages.batch, stages.memory.frame.grids)));
      sets_.back()->features.number = i;
    }
    if (stages.settings.use_graphs) {
      for (auto& s : sets_) { s->features.record(exec); }
      exchange(stages, *sets_.front());
      sets_.front()->features.record(exec);
      exchange(stages, *sets_.front());
    }
    exec.wait();
  }

  /// Takes the images of a frame, and starts on them.
  /// @throws bad_argument for images that are null or of another size, or if no set is free
  void give(images_type const* images, int batch) {
    require(given_ < sets_.size(),
            "as many frames as odometry_params::prefetch are given already: track one first");
    set& s = *sets_[(first_ + given_) % sets_.size()];
    for (int b = 0; b < batch; ++b) { s.features.input.take(b, images[b]); }
    s.run = s.beside.begin();
    ++given_;
  }
  /// @throws bad_argument if no frame is given
  void require_given() const {
    require(given_ > 0, "no images were given: prefetch() those of the frame first");
  }
  /// The stages get the features of the frame that was given first. On the host it waits for them.
  template <typename Stages>
  void use(Exec const& exec, Stages& stages) {
    set& s = next();
    s.beside.finish(exec, s.run);
    exchange(stages, s);
  }
  /// Forgets the frames that were given. Waits for their features.
  void forget(Exec const& exec) {
    if (given_ == 0) { return; }
    for (auto& s : sets_) { s->beside.drain(); }  // before finish(), which may throw
    while (given_ > 0) {
      set& s = next();
      s.beside.finish(exec, s.run);
    }
  }
  /// Calls each(orb_extractor&) for those of all sets. Waits until none is used.
  template <typename Each>
  void for_each_extractor(Each const& each) {
    for (auto& s : sets_) {
      s->beside.drain();
      each(s->features.extractor);
    }
  }
  /// Calls each() while the stages have the features of each set, and then those that they had.
  template <typename Stages, typename Each>
  void for_each_set(Stages& stages, Each const& each) {
    for (auto& s : sets_) {
      exchange(stages, *s);
      each();
      exchange(stages, *s);
    }
  }
  allocated_bytes bytes() const {
    allocated_bytes all;
    for (auto const& s : sets_) { all = all + s->features.bytes(); }
    return all;
  }

private:
  /// A set has one of so many parts of the host's threads: few threads wait for each other less,
  /// and other sets and the tracking run at the same time.
  static constexpr int parts = 2;

  struct work {
    features_type* features;

    void enqueue(Exec const& exec, int /*run*/) { features->replay(exec); }
  };
  struct set {
    features_type features;
    int run = 0;
    work_beside<Exec, work> beside;  ///< last: it ends first

    set(Exec const& exec, features_type made)
        : features(std::move(made)), beside(exec, work{&features}, 1, parts) {}
  };

  set& next() {
    set& s = *sets_[first_];
    first_ = (first_ + 1) % sets_.size();
    --given_;
    return s;
  }
  template <typename Stages>
  static void exchange(Stages& stages, set& s) {
    stages.exchange_features(s.features);
  }

  std::vector<std::unique_ptr<set>> sets_;
  std::size_t first_ = 0;
  std::size_t given_ = 0;
};

}  // namespace detail
}  // namespace FT_ABI
}  // namespace ft
