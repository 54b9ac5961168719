// SPDX-License-Identifier: Apache-2.0
#include <algorithm>
#include <system_error>
#include <utility>

#include "examples/sequence/detail/layout.hpp"
#include "examples/sequence/detail/stamps.hpp"
#include "examples/sequence/detail/text.hpp"

namespace seq::detail {
namespace {

namespace fs = std::filesystem;

/// The words of each line that is no comment; each line has `count` of them.
std::vector<std::pair<int, std::vector<std::string>>> read_words(std::string const& path,
                                                                 std::size_t count,
                                                                 char const* what) {
  std::vector<std::pair<int, std::vector<std::string>>> lines;
  for (text_line const& line : read_lines(path)) {
    if (is_blank_or_comment(line.text)) { continue; }
    std::vector<std::string> words = split(line.text, " \t,", true);
    if (words.size() != count) {
      fail_at(path, line.number,
              std::to_string(words.size()) + " words, must have " + std::to_string(count) + " (" +
                  what + ")");
    }
    lines.emplace_back(line.number, std::move(words));
  }
  if (lines.empty()) { throw error(path + ": lists no images"); }
  return lines;
}

/// A stamp in seconds, or the number of a frame. @param rate 0 = seconds; of frames
std::int64_t time_of(std::string const& text, std::string const& path, int line, double rate) {
  std::int64_t const time = seconds_to_ns(text, path, line);
  return rate > 0 ? time_of_frame(1e-9 * static_cast<double>(time), rate, path) : time;
}

/// Whether the first words of a list count frames, as ICL-NUIM has them: whole numbers, one by one.
bool counts_frames(std::string const& path) {
  std::vector<std::int64_t> numbers;
  for (text_line const& line : read_lines(path)) {
    if (is_blank_or_comment(line.text)) { continue; }
    std::string const word = split(line.text, " \t,", true).front();
    bool const whole = word.size() <= 9 && std::all_of(word.begin(), word.end(), is_digit);
    if (!whole) { return false; }
    numbers.push_back(std::stoll(word));
  }
  constexpr std::int64_t least_step = 5;  // as of names that are times
  return numbers.size() > 1 && median_step(numbers) < least_step;
}

/// Sets the rate of a list that counts frames. @throws seq::error where nobody says it
void set_rate(std::string const& path, open_options const& options, layout_of_files& layout) {
  if (!counts_frames(path)) { return; }
  if (options.fps == 0) {
    throw error(path +
                ": the time stamps count frames: a rate says their times, --fps 30 (fps=30) of "
                "ICL-NUIM; accepted are else times in seconds");
  }
  layout.rate = options.fps;
}

/// ICL-NUIM: the file with the poses, livingRoom2.gt.freiburg; empty without.
std::string find_icl_truth(fs::path const& root) {
  std::vector<std::string> found;
  std::error_code failure;
  for (fs::directory_iterator it(root, failure), end; !failure && it != end;
       it.increment(failure)) {
    std::string const name = it->path().filename().string();
    std::string const end_of_name = ".gt.freiburg";
    if (name.size() > end_of_name.size() &&
        name.compare(name.size() - end_of_name.size(), end_of_name.size(), end_of_name) == 0) {
      found.push_back(it->path().string());
    }
  }
  return found.size() == 1 ? found.front() : std::string();
}

/// rgb.txt, depth.txt, or OpenLORIS' color.txt, aligned_depth.txt
std::vector<listed_image> read_list(fs::path const& root, std::string const& name, double rate,
                                    std::vector<std::string>& warnings) {
  std::string const path = (root / name).string();
  std::vector<std::int64_t> times;
  std::vector<std::string> files;
  for (auto const& [number, words] : read_words(path, 2, "time, file")) {
    times.push_back(time_of(words[0], path, number, rate));
    files.push_back(words[1]);
  }
  std::vector<listed_image> images;
  for (std::size_t const i : ordered_lines(times, disordered::sorted, path, "images", warnings)) {
    images.push_back({times[i], find_image(root, files[i])});
  }
  return images;
}

/// A depth image's name has "depth" in it. ICL-NUIM lists depth first.
bool depth_first(std::vector<std::string> const& words) {
  return words[1].find("depth") != std::string::npos && words[3].find("depth") == std::string::npos;
}

/// associations.txt: time and file of a colour image, time and file of its depth image.
void read_associations(std::string const& path, std::int64_t most_ns, layout_of_files& layout) {
  std::vector<std::int64_t> times;
  std::vector<frame_files> frames;
  int far = 0;
  std::int64_t farthest = 0;
  for (auto const& [number, words] : read_words(path, 4, "time, colour, time, depth")) {
    std::size_t const colour = depth_first(words) ? 2 : 0;
    std::size_t const depth = 2 - colour;
    std::int64_t const time = time_of(words[colour], path, number, layout.rate);
    std::int64_t const other = time_of(words[depth], path, number, layout.rate);
    std::int64_t const apart = time < other ? other - time : time - other;
    if (apart > most_ns) {
      ++far;
      farthest = std::max(farthest, apart);
      continue;
    }
    frames.push_back({time, find_image(layout.root, words[colour + 1]),
                      find_image(layout.root, words[depth + 1])});
    times.push_back(time);
  }
  if (far > 0) {
    layout.warnings.push_back(path + ": " + std::to_string(far) + " pairs left out: up to " +
                              milliseconds(farthest) + " ms apart, at most " +
                              milliseconds(most_ns) + " ms allowed");
  }
  for (std::size_t const i :
       ordered_lines(times, disordered::sorted, path, "pairs", layout.warnings)) {
    frame_files const& frame = frames[i];
    if (!frame.left.empty() && !frame.second.empty()) {
      layout.frames.push_back(frame);
    } else {
      layout.unpaired.left += static_cast<int>(!frame.left.empty());
      layout.unpaired.right += static_cast<int>(!frame.second.empty());
    }
  }
  if (layout.frames.empty()) {
    throw error(path + ": " + std::to_string(frames.size() + static_cast<std::size_t>(far)) +
                " pairs, none that can be taken: " + std::to_string(far) + " more than " +
                milliseconds(most_ns) + " ms apart, " + std::to_string(frames.size()) +
                " without both files");
  }
}

/// Whether the recording is one of the benchmark itself, by its folder or a comment of its lists.
/// @param camera gets the number of its camera
bool is_of_tum(fs::path const& root, int& camera) {
  std::string const name = "rgbd_dataset_freiburg";
  auto const named = [&](std::string const& text) {
    std::size_t const at = text.find(name);
    if (at == std::string::npos) { return false; }
    std::size_t const digit = at + name.size();
    camera = digit < text.size() && is_digit(text[digit]) ? text[digit] - '0' : 0;
    return true;
  };
  if (named(root.filename().string())) { return true; }
  for (char const* list : {"rgb.txt", "depth.txt"}) {
    std::string const path = (root / list).string();
    if (!is_file(path)) { continue; }
    for (text_line const& line : read_lines(path)) {
      if (!is_blank_or_comment(line.text)) { break; }
      if (named(line.text)) { return true; }
    }
  }
  return false;
}

}  // namespace

void find_tum_frames(layout_of_files& layout, open_options const& options) {
  auto const path = [&](std::string const& name) { return (layout.root / name).string(); };
  if (is_pair(options.rig)) {
    throw error(layout.root.string() + ": the layout " + title_of(layout.name) +
                " has no second camera");
  }
  bool const loris = layout.name == "openloris";
  std::string const colours = loris ? "color.txt" : "rgb.txt";
  std::string const depths = loris ? "aligned_depth.txt" : "depth.txt";
  std::string const both = loris ? std::string() : "associations.txt";
  bool const has_both = !loris && is_file(path(both));
  bool const depth = has_both || is_file(path(depths));
  if (options.rig == camera_kind::rgbd && !depth) { refuse_depths(layout); }
  if (options.rig == camera_kind::any && !depth) {
    layout.warnings.push_back(
        path(depths) +
        ": no such file, nor associations.txt: tracked as one camera, without depth images; "
        "--rig mono (rig=\"mono\") says that it is meant so");
  }
  if (loris) { layout.depth_unit = 1e-3; }
  layout.y_up_truth = find_icl_truth(layout.root);
  layout.of_tum = !loris && (is_of_tum(layout.root, layout.freiburg) || !layout.y_up_truth.empty());
  layout.stamps_from = is_file(path(colours)) ? colours : both;
  layout.kind = depth && options.rig != camera_kind::mono ? camera_kind::rgbd : camera_kind::mono;
  std::int64_t const most = options.max_time_difference_ns.value_or(most_to_depth_ns);
  if (has_both && (layout.kind == camera_kind::rgbd || !is_file(path(colours)))) {
    set_rate(path(both), options, layout);
    read_associations(path(both), most, layout);
    return;
  }
  set_rate(path(colours), options, layout);
  two_lists lists;
  lists.left = read_list(layout.root, colours, layout.rate, layout.warnings);
  lists.left_name = colours;
  if (layout.kind == camera_kind::rgbd) {
    lists.second = read_list(layout.root, depths, layout.rate, layout.warnings);
    lists.second_name = depths;
    pair_frames(lists, most, layout);
    return;
  }
  take_images(lists.left, path(colours), layout);
}

}  // namespace seq::detail
