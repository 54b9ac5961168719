// SPDX-License-Identifier: Apache-2.0
/// @file The calls of device_tracker that depend on no frame there: words, and poses by RANSAC.
#pragma once

#include <memory>
#include <string>
#include <utility>

#include "ft/core/config.hpp"
#include "integration/orbslam3/device_bags.hpp"
#include "integration/orbslam3/device_pnp.hpp"
#include "integration/orbslam3/device_word_search.hpp"
#include "integration/orbslam3/executor_calls.hpp"
#include "integration/orbslam3/rigs.hpp"

namespace ft {
namespace orbslam3 {
inline namespace FT_ABI {

/// Base of a tracker on an executor. Each stage has a stream of its own: what tracking has started
/// for the next call goes on.
template <typename Exec, typename Rig>
class word_calls : public executor_calls<Exec> {
public:
  explicit word_calls(Exec exec) : executor_calls<Exec>(std::move(exec)) {}

  void load_vocabulary(std::string const& path, vocabulary_facts const* expected) override {
    bags_->load(path, expected);
  }
  bool has_vocabulary() const override { return bags_->loaded(); }
  word_lists transform_words(descriptor_rows const& rows) override {
    return bags_->transform(rows);
  }
  word_arrays& words_of(word_side side) override { return search_->arrays(side); }
  word_matches search_by_words(word_search_request const& request) override {
    return search_->search(request);
  }
  pnp_arrays& correspondences() override { return pnp_->arrays(); }
  pnp_found solve_pnp(pnp_progress& progress) override { return pnp_->solve(progress); }

protected:
  /// Allocates all memory, waits; called by the constructor. @param keypoints per image
  void make_words(Exec const& exec, settings const& s, int keypoints) {
    int const all = this->cameras() * keypoints;
    bags_ = std::make_unique<device_bags<Exec>>(exec, all, s.levels_up);
    search_ = std::make_unique<device_word_search<Exec>>(exec, all);
    pnp_ = std::make_unique<pnp_solver>(exec, left_camera(rig_of<Rig>(s)), keypoints);
  }
  void measure_words(bool on) {
    bags_->measure(on);
    search_->measure(on);
    pnp_->measure(on);
  }

private:
  using pnp_solver = device_pnp<Exec, left_camera_of<Rig>>;

  std::unique_ptr<device_bags<Exec>> bags_;
  std::unique_ptr<device_word_search<Exec>> search_;
  std::unique_ptr<pnp_solver> pnp_;
};

}  // namespace FT_ABI
}  // namespace orbslam3
}  // namespace ft
