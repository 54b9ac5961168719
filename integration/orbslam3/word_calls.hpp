// SPDX-License-Identifier: Apache-2.0
/// @file The calls of device_tracker that are about words.
#pragma once

#include <memory>
#include <string>

#include "ft/core/config.hpp"
#include "integration/orbslam3/device_bags.hpp"
#include "integration/orbslam3/device_tracker.hpp"
#include "integration/orbslam3/device_word_search.hpp"

namespace ft {
namespace orbslam3 {
inline namespace FT_ABI {

/// Base of a tracker on an executor.
template <typename Exec>
class word_calls : public device_tracker {
public:
  void load_vocabulary(std::string const& path) override { bags_->load(path); }
  bool has_vocabulary() const override { return bags_->loaded(); }
  word_lists transform_words(descriptor_rows const& rows) override {
    return bags_->transform(rows);
  }
  word_arrays& words_of(word_side side) override { return search_->arrays(side); }
  word_matches search_by_words(word_search_request const& request) override {
    return search_->search(request);
  }

protected:
  /// Allocates all memory, waits; called by the constructor. @param keypoints of a frame
  void make_words(Exec const& exec, int keypoints, int levels_up) {
    bags_ = std::make_unique<device_bags<Exec>>(exec, keypoints, levels_up);
    search_ = std::make_unique<device_word_search<Exec>>(exec, keypoints);
  }
  void measure_words(bool on) {
    bags_->measure(on);
    search_->measure(on);
  }

private:
  std::unique_ptr<device_bags<Exec>> bags_;
  std::unique_ptr<device_word_search<Exec>> search_;
};

}  // namespace FT_ABI
}  // namespace orbslam3
}  // namespace ft
