// SPDX-License-Identifier: Apache-2.0
/// @file Extracts the image of a golden case, with the tie rule std_sort, and counts the keypoints
/// and descriptors that are identical.
#pragma once

#include <algorithm>
#include <cstddef>
#include <cstdint>
#include <cstring>
#include <filesystem>
#include <fstream>
#include <nlohmann/json.hpp>
#include <stdexcept>
#include <string>
#include <utility>

#include "ft/pipelines/orb_extractor.hpp"
#include "tests/conformance/golden_inertial.hpp"
#include "tests/conformance/golden_inertial_pose.hpp"
#include "tests/conformance/golden_sequence.hpp"
#include "tests/conformance/golden_words.hpp"
#include "tests/conformance/image_file.hpp"
#include "tests/support/memory.hpp"
#include "tests/support/npy.hpp"

namespace test {

/// One image with parameters of its own, as FORMAT.md in golden_std_sort describes it. Its image
/// is in the case's folder, or below the folder that holds golden_std_sort.
template <typename Exec>
class golden_case {
public:
  golden_case(Exec const& exec, std::string folder) : exec_(exec), folder_(std::move(folder)) {
    std::ifstream file(folder_ + "/case.json");
    auto const json = nlohmann::json::parse(file);
    params_.width = json["width"];
    params_.height = json["height"];
    params_.features = json["features"];
    params_.levels = json["levels"];
    params_.scale_factor = json["scale_factor"];
    params_.ini_threshold = json["ini_threshold"];
    params_.min_threshold = json["min_threshold"];
    params_.ties = ft::tie_rule::std_sort;
    std::string const image = json["image"];
    auto const here = std::filesystem::absolute(folder_) / "";
    bool const beside = exists((here / image).string());
    image_path_ = ((beside ? here : here / "../..") / image).lexically_normal().string();
  }

  void run(conformance_table& table) const {
    grey_pixels const image = read_grey(image_path_);
    if (image.width != params_.width || image.height != params_.height) {
      throw std::runtime_error(image_path_ + ": not of the size that " + folder_ + " says");
    }
    ft::orb_extractor<Exec> orb(exec_, params_, 1);
    orb.upload(exec_, 0, {image.pixels.data(), image.width, image.height, image.width});
    orb.extract(exec_);
    exec_.wait();
    compare(table, orb.keypoints());
  }

private:
  void compare(conformance_table& table, ft::keypoints_view const& got) const {
    auto const keypoints = read_npy<float>(folder_ + "/keypoints.npy");
    auto const descriptors = read_npy<std::uint8_t>(folder_ + "/descriptors.npy");
    auto const x = column<ft::field::x>(exec_, got);
    auto const y = column<ft::field::y>(exec_, got);
    auto const angle = column<ft::field::angle>(exec_, got);
    auto const response = column<ft::field::response>(exec_, got);
    auto const octave = column<ft::field::octave>(exec_, got);
    auto const orb = column<ft::field::orb>(exec_, got);
    int const count = from_exec(exec_, static_cast<int const*>(got.count), 1)[0];
    int const wanted = keypoints.rows();
    auto& same_keypoints = table["keypoints_std_sort"];
    auto& same_descriptors = table["descriptors_std_sort"];
    for (int i = 0; i < std::max(count, wanted); ++i) {
      auto const at = static_cast<std::size_t>(i);
      bool const both = i < count && i < wanted;
      same_keypoints.add(both && x[at] == keypoints(i, 0) && y[at] == keypoints(i, 1) &&
                         angle[at] == keypoints(i, 2) &&
                         static_cast<float>(response[at]) == keypoints(i, 3) &&
                         static_cast<float>(octave[at]) == keypoints(i, 4));
      same_descriptors.add(both && std::memcmp(&orb[at], &descriptors(i, 0), 32) == 0);
    }
  }

  Exec exec_;
  std::string folder_;
  ft::orb_params params_;
  std::string image_path_;
};

/// All that a golden folder holds: a sequence, a case, what IMUs measured, or words and recovery.
template <typename Exec>
conformance_table run_golden(Exec const& exec, std::string const& folder) {
  conformance_table table;
  if (is_words(folder)) {
    run_words(exec, folder, table);
  } else if (is_inertial(folder)) {
    golden_inertial<Exec>(exec, folder).run(table);
    run_inertial_poses(exec, folder, table);
  } else if (exists(folder + "/case.json")) {
    golden_case<Exec>(exec, folder).run(table);
  } else {
    golden_sequence<Exec>(exec, folder).run(table);
  }
  return table;
}

}  // namespace test
