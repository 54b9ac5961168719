// SPDX-License-Identifier: Apache-2.0
#include "examples/sequence/report.hpp"

#include <gtest/gtest.h>
#include <nlohmann/json.hpp>

#include <algorithm>
#include <cctype>
#include <chrono>
#include <cmath>
#include <cstdint>
#include <filesystem>
#include <fstream>
#include <iterator>
#include <limits>
#include <set>
#include <sstream>
#include <string>
#include <thread>
#include <vector>

namespace {

constexpr double nan_value = std::numeric_limits<double>::quiet_NaN();
constexpr double inf_value = std::numeric_limits<double>::infinity();

std::string read_text(std::string const& path) {
  std::ifstream in(path, std::ios::binary);
  return {std::istreambuf_iterator<char>(in), std::istreambuf_iterator<char>()};
}

std::vector<std::string> split(std::string const& text, char separator) {
  std::vector<std::string> out;
  std::string item;
  std::istringstream in(text);
  while (std::getline(in, item, separator)) { out.push_back(item); }
  if (!text.empty() && text.back() == separator && separator != '\n') { out.emplace_back(); }
  return out;
}

int count(std::string const& text, std::string const& word) {
  int n = 0;
  for (std::size_t at = text.find(word); at != std::string::npos; at = text.find(word, at + 1)) {
    ++n;
  }
  return n;
}

/// Decimal digits with an optional sign and fraction, and nothing else.
bool is_number(std::string const& text) {
  auto const digits = [](std::string const& part) {
    return !part.empty() && part.find_first_not_of("0123456789") == std::string::npos;
  };
  std::string const magnitude = text.substr(text.rfind('-', 0) == 0 ? 1 : 0);
  std::size_t const point = magnitude.find('.');
  if (point == std::string::npos) { return digits(magnitude); }
  return digits(magnitude.substr(0, point)) && digits(magnitude.substr(point + 1));
}

/// True where `word` stands in `text` with no letter before or after it.
bool has_word(std::string const& text, std::string const& word) {
  auto const letter = [&](std::size_t i) {
    return i < text.size() && std::isalpha(static_cast<unsigned char>(text[i])) != 0;
  };
  for (std::size_t at = text.find(word); at != std::string::npos; at = text.find(word, at + 1)) {
    if ((at == 0 || !letter(at - 1)) && !letter(at + word.size())) { return true; }
  }
  return false;
}

/// The page's script; empty where there is none.
std::string script_of(std::string const& html) {
  std::size_t const begin = html.find("<script>");
  std::size_t const end = html.find("</script>");
  if (begin == std::string::npos || end == std::string::npos) { return {}; }
  return html.substr(begin + 8, end - begin - 8);
}

/// What a script has that it should not: a way to load something, to run a text as a script or to
/// end the element early; numbers that are none; brackets that do not match. Empty where all is
/// well.
std::string script_fault(std::string const& script) {
  for (char const* word :
       {"<",       "http", "fetch", "XMLHttp", "import",   "WebSocket", "Worker",         "Image",
        "url",     "src",  "href",  "eval",    "Function", "innerHTML", "document.write", "cookie",
        "Storage", "NaN",  "nan",   "Infinity"}) {
    if (script.find(word) != std::string::npos) { return word; }
  }
  if (has_word(script, "inf")) { return "inf"; }
  std::string open;
  char quote = 0;
  for (char const c : script) {
    if (quote != 0) {
      if (c == quote) { quote = 0; }
    } else if (c == '"' || c == '\'') {
      quote = c;
    } else if (c == '(' || c == '[' || c == '{') {
      open += c;
    } else if (c == ')' || c == ']' || c == '}') {
      char const wanted = c == ')' ? '(' : c == ']' ? '[' : '{';
      if (open.empty() || open.back() != wanted) { return std::string("stray ") + c; }
      open.pop_back();
    }
  }
  if (quote != 0) { return "text without end"; }
  return open;
}

/// What is wrong with the markup: tags that do not nest, attributes that do not parse, numbers that
/// are not numbers, references to elsewhere, more than the one script, one that could load
/// something. Empty where all is well. Pictures are cut out first.
std::string markup_fault(std::string html) {
  std::size_t const style = html.find("<style>");
  std::size_t const style_end = html.find("</style>");
  if (style == std::string::npos || style_end == std::string::npos) { return "no style"; }
  if (html.substr(style, style_end - style).find("url(") != std::string::npos) {
    return "url in style";
  }
  if (html.find("@import") != std::string::npos) { return "@import"; }
  html.erase(style + 7, style_end - style - 7);
  if (std::string const fault = script_fault(script_of(html)); !fault.empty()) {
    return "script: " + fault;
  }
  if (std::size_t const script = html.find("<script>"); script != std::string::npos) {
    std::size_t const end = html.find("</script>");
    if (end == std::string::npos || end < script) { return "script without end"; }
    html.erase(script, end + 9 - script);  // any other is a fault below
  }

  static std::set<std::string> const texts = {"class",   "role",    "aria-label",
                                              "lang",    "name",    "charset",
                                              "content", "href",    "preserveAspectRatio",
                                              "fill",    "stroke",  "stroke-linecap",
                                              "d",       "viewBox", "transform"};
  static std::set<std::string> const numbers = {
      "x", "y", "cx", "cy", "r", "rx", "width", "height", "stroke-width", "stroke-opacity"};
  auto const only = [](std::string const& value, char const* allowed) {
    return value.find_first_not_of(allowed) == std::string::npos;
  };
  std::vector<std::string> open;
  std::size_t at = 0;
  while ((at = html.find('<', at)) != std::string::npos) {
    std::size_t const end = html.find('>', at);
    if (end == std::string::npos) { return "unclosed <"; }
    std::string tag = html.substr(at + 1, end - at - 1);
    at = end + 1;
    if (tag.empty() || tag.find('<') != std::string::npos) {
      return "stray <: " + tag.substr(0, 80);
    }
    if (tag.front() == '!') { continue; }
    if (tag.front() == '/') {
      if (open.empty() || open.back() != tag.substr(1)) { return "closes nothing: " + tag; }
      open.pop_back();
      continue;
    }
    bool const closed = tag.back() == '/';
    if (closed) { tag.pop_back(); }
    std::size_t p = tag.find_first_of(" \n");
    std::string const name = tag.substr(0, p);
    if (name == "script" || name == "link" || name == "iframe" || name == "img") { return name; }
    while (p != std::string::npos && (p = tag.find_first_not_of(" \n", p)) != std::string::npos) {
      std::size_t const equals = tag.find("=\"", p);
      if (equals == std::string::npos) { return "attribute without value: " + tag.substr(p, 80); }
      std::size_t const quote = tag.find('"', equals + 2);
      if (quote == std::string::npos) { return "attribute without quote: " + tag.substr(p, 80); }
      std::string const key = tag.substr(p, equals - p);
      std::string const value = tag.substr(equals + 2, quote - equals - 2);
      p = quote + 1;
      std::string const where = name + ' ' + key + "=" + value.substr(0, 80);
      if (numbers.count(key) != 0) {
        if (name == "meta" || !is_number(value)) { return "not a number: " + where; }
      } else if (texts.count(key) == 0) {
        return "unknown attribute: " + where;
      }
      if (key == "d" && (value.empty() || !only(value, "MLHVZzlhv0123456789.- "))) {
        return "path: " + where;
      }
      if (key == "viewBox" && !only(value, "0123456789. ")) { return "view box: " + where; }
      if (key == "transform" && !only(value, "translateo()0123456789.- ")) {
        return "transform: " + where;
      }
      if (key == "href" && value.rfind("data:image/jpeg;base64,", 0) != 0) {
        return "reference: " + where;
      }
      if (key == "src") { return "reference: " + where; }
    }
    if (!closed && name != "meta") { open.push_back(name); }
  }
  return open.empty() ? std::string() : "never closed: " + open.back();
}

/// Pixels that a JPEG cannot compress well.
seq::image noisy(int width, int height, std::uint32_t seed) {
  seq::image out;
  out.width = width;
  out.height = height;
  out.pixels.resize(static_cast<std::size_t>(width) * static_cast<std::size_t>(height));
  for (std::uint8_t& p : out.pixels) {
    seed = seed * 1664525U + 1013904223U;
    p = static_cast<std::uint8_t>(seed >> 24U);
  }
  return out;
}

seq::run_report filled(int frames, bool truth) {
  seq::run_report r;
  r.title = "Run";
  r.sequence = "room";
  r.backend = "host";
  r.device = "processor";
  r.options = {{"levels", "8"}, {"output", "here"}};
  r.image_width = 64;
  r.image_height = 48;
  r.frames = frames;
  r.map_points = 1234;
  r.stages = {"fast", "match", "total"};
  for (int i = 0; i < frames; ++i) {
    seq::frame_record f;
    f.index = i;
    f.time_ns = 1'403'636'579'763'555'584LL + i * 50'000'000LL;
    f.tracked = i % 10 != 7;
    f.keyframe = i % 5 == 0;
    f.keypoints = 1000;
    f.stereo_matches = 600;
    f.inliers = f.tracked ? 200 + i % 3 : 0;
    f.local_points = 800;
    f.stage_ms = {1.0 + i % 2, 2.0, i == 3 ? 400.0 : 4.0 + i % 2};
    seq::stamped_pose p;
    p.time_ns = f.time_ns;
    p.T_world_camera.translation() = Eigen::Vector3d(std::cos(i * 0.01), 0.1, std::sin(i * 0.01));
    if (truth) { r.truth.push_back(p); }
    if (f.tracked) {
      p.T_world_camera.translation().x() += 0.01 * (i % 4);
      r.estimate.push_back(p);
      ++r.tracked;
    } else {
      ++r.lost;
    }
    if (f.keyframe) { ++r.keyframes; }
    r.records.push_back(f);
  }
  r.error.path_m = 12.5;
  if (truth) {
    r.error.pairs = r.tracked;
    r.error.truth_path_m = 12.25;
    r.error.estimate_path_m = 12.5;
    r.error.ate_rmse_m = 0.05;
    r.error.rpe_rmse_m = 0.025;
    r.error.ate_rotation_rmse_deg = 1.5;
    r.error.rpe_rotation_rmse_deg = 0.75;
    r.error.rpe_span = 20;
  }
  return r;
}

/// Points on the walls of a room around the path.
void add_cloud(seq::run_report& r, int points) {
  for (int i = 0; i < points; ++i) {
    auto const t = static_cast<float>(i);
    r.cloud.emplace_back(3 * std::cos(t), std::sin(0.37F * t), 3 * std::sin(t));
  }
}

void add_sample(seq::run_report& r, int width, int height, int keypoints) {
  seq::sample_frame s;
  s.index = static_cast<int>(r.samples.size()) * 10;
  s.picture = noisy(width, height, static_cast<std::uint32_t>(s.index + 1));
  for (int i = 0; i < keypoints; ++i) {
    seq::sample_frame::keypoint k;
    k.x = static_cast<float>((i * 7919) % width) + 0.5F;
    k.y = static_cast<float>((i * 104729) % height) + 0.25F;
    k.octave = i % 8;
    k.size = 31.0F * std::pow(1.2F, static_cast<float>(k.octave));
    if (i % 3 != 0) { k.depth = 1.0F + static_cast<float>(i % 40); }
    k.matched = i % 2 == 0;
    if (i % 4 == 0) {
      k.from_x = k.x + 2;
      k.from_y = k.y + 1;
    }
    s.keypoints.push_back(k);
  }
  r.samples.push_back(std::move(s));
}

class report : public ::testing::Test {
protected:
  void SetUp() override {
    auto const* const info = ::testing::UnitTest::GetInstance()->current_test_info();
    auto const stamp = std::chrono::steady_clock::now().time_since_epoch().count();
    folder_ = std::filesystem::path(::testing::TempDir()) /
              (std::string("ft_report_") + info->name() + '_' + std::to_string(stamp));
    std::filesystem::create_directories(folder_);
  }
  void TearDown() override {
    std::error_code ignored;
    std::filesystem::remove_all(folder_, ignored);
  }
  std::string file(std::string const& name) const { return (folder_ / name).string(); }

  nlohmann::json summary(seq::run_report const& r) const {
    seq::write_summary_json(file("summary.json"), r);
    return nlohmann::json::parse(read_text(file("summary.json")));
  }
  std::string html(seq::run_report const& r) const {
    seq::write_html(file("report.html"), r);
    return read_text(file("report.html"));
  }

  std::filesystem::path folder_;
};

// ------------------------------------------------------------------------------------- statistics

TEST_F(report, statistics_match_numbers_by_hand) {
  seq::statistics const s =
      seq::summarise({9, 2, 4, 4, 4, 5, 5, 7});  // the textbook example: std 2
  EXPECT_DOUBLE_EQ(s.mean, 5);
  EXPECT_DOUBLE_EQ(s.std, 2);
  EXPECT_DOUBLE_EQ(s.p50, 4);  // the 4th of 8
  EXPECT_DOUBLE_EQ(s.p99, 9);
  EXPECT_DOUBLE_EQ(s.max, 9);
}

TEST_F(report, how_a_run_was_made_is_in_all_its_files) {
  seq::run_report r;
  r.backend = "host";
  r.version = "1.2.3";
  r.date = seq::utc_now();
  r.threads = 7;
  r.command = seq::command_line({"track_sequence", "my folder", "--out=a", "it's"});
  EXPECT_EQ(r.command, "track_sequence 'my folder' --out=a 'it'\\''s'");
  EXPECT_EQ(r.date.size(), 20u);
  EXPECT_EQ(r.date[10], 'T');
  EXPECT_EQ(r.date.back(), 'Z');
  r.error.drift_percent = 1.25;
  r.error.ate_axes_m = Eigen::Vector3d(0.1, 0.2, 0.3);
  auto const json = summary(r);
  EXPECT_EQ(json.at("version"), "1.2.3");
  EXPECT_EQ(json.at("date"), r.date);
  EXPECT_EQ(json.at("threads"), 7);
  EXPECT_EQ(json.at("command"), r.command);
  EXPECT_EQ(json.at("drift_percent"), 1.25);
  EXPECT_EQ(json.at("ate_axes_m"), (nlohmann::json{0.1, 0.2, 0.3}));
  std::string const page = html(r);
  for (char const* part : {"1.2.3", "my folder", "threads</th><td>7"}) {
    EXPECT_NE(page.find(part), std::string::npos) << part;
  }
  EXPECT_NE(page.find(r.date), std::string::npos);
  std::ostringstream printed;
  seq::print_summary(printed, r);
  EXPECT_NE(printed.str().find("x 0.1000, y 0.2000, z 0.3000 m"), std::string::npos);
  EXPECT_NE(printed.str().find("1.25 % of"), std::string::npos);
}

TEST_F(report, percentiles_are_nearest_rank) {
  std::vector<double> samples;
  for (int i = 200; i >= 1; --i) { samples.push_back(i); }
  seq::statistics const s = seq::summarise(samples);
  EXPECT_DOUBLE_EQ(s.p50, 100);  // rank ceil(0.5 * 200)
  EXPECT_DOUBLE_EQ(s.p99, 198);  // rank ceil(0.99 * 200)
  EXPECT_DOUBLE_EQ(s.mean, 100.5);
  samples.push_back(201);
  EXPECT_DOUBLE_EQ(seq::summarise(samples).p50, 101);
  EXPECT_DOUBLE_EQ(seq::summarise(samples).p99, 199);  // ceil(198.99)
}

TEST_F(report, statistics_of_none_one_and_unusable_samples) {
  for (auto const& samples : {std::vector<double>{}, std::vector<double>{nan_value, inf_value}}) {
    seq::statistics const s = seq::summarise(samples);
    EXPECT_EQ(s.mean, 0);
    EXPECT_EQ(s.std, 0);
    EXPECT_EQ(s.p50, 0);
    EXPECT_EQ(s.p99, 0);
    EXPECT_EQ(s.max, 0);
  }
  seq::statistics const s = seq::summarise({nan_value, -3, inf_value});
  EXPECT_EQ(s.mean, -3);
  EXPECT_EQ(s.std, 0);
  EXPECT_EQ(s.p50, -3);
  EXPECT_EQ(s.max, -3);
}

TEST_F(report, standard_deviation_survives_a_large_mean) {
  EXPECT_NEAR(seq::summarise({1e9 + 1, 1e9 + 3}).std, 1, 1e-6);
}

// ------------------------------------------------------------------------------------------- json

TEST_F(report, json_holds_every_key) {
  nlohmann::json const j = summary(filled(20, true));
  for (char const* key :
       {"title",        "sequence",   "backend",    "device",       "image_width",
        "image_height", "frames",     "tracked",    "lost",         "dropped",
        "keyframes",    "map_points", "path_m",     "truth_path_m", "estimate_path_m",
        "pairs",        "ate_rmse_m", "rpe_rmse_m", "mean_inliers", "mean_keypoints",
        "fps",          "stages",     "options"}) {
    EXPECT_TRUE(j.contains(key)) << key;
  }
  EXPECT_EQ(j["frames"], 20);
  EXPECT_EQ(j["tracked"], 18);
  EXPECT_EQ(j["lost"], 2);
  EXPECT_EQ(j["keyframes"], 4);
  EXPECT_EQ(j["backend"], "host");
  EXPECT_EQ(j["options"]["levels"], "8");
  EXPECT_DOUBLE_EQ(j["path_m"], 12.5);
  EXPECT_DOUBLE_EQ(j["truth_path_m"], 12.25);
  EXPECT_DOUBLE_EQ(j["ate_rmse_m"], 0.05);
  EXPECT_DOUBLE_EQ(j["rpe_rmse_m"], 0.025);
  EXPECT_DOUBLE_EQ(j["mean_keypoints"], 1000);
  // the total is 4 for the ten even frames, 5 for nine odd ones, 400 for frame 3
  EXPECT_NEAR(j["fps"], 20 / ((10 * 4.0 + 9 * 5.0 + 400.0) / 1000), 1e-9);
  ASSERT_EQ(j["stages"].size(), 3U);
  for (char const* stage : {"fast", "match", "total"}) {
    for (char const* key : {"mean_ms", "std_ms", "p50_ms", "p99_ms", "max_ms"}) {
      EXPECT_TRUE(j["stages"][stage][key].is_number()) << stage << ' ' << key;
    }
  }
  EXPECT_DOUBLE_EQ(j["stages"]["match"]["mean_ms"], 2);
  EXPECT_DOUBLE_EQ(j["stages"]["total"]["max_ms"], 400);
}

TEST_F(report, the_time_from_images_to_pose_leads) {
  seq::run_report r = filled(20, true);
  EXPECT_TRUE(summary(r)["images_to_pose"].is_null());  // not measured
  for (auto& f : r.records) { f.images_to_pose_ms = 20 + f.index; }
  r.wall_s = 2;
  nlohmann::json j = summary(r);
  EXPECT_DOUBLE_EQ(j["images_to_pose"]["mean_ms"], 29.5);
  EXPECT_DOUBLE_EQ(j["images_to_pose"]["p50_ms"], 29);
  EXPECT_DOUBLE_EQ(j["images_to_pose"]["p99_ms"], 39);
  EXPECT_EQ(j["prefetch"], 0);
  EXPECT_TRUE(j["fps"].is_number());
  auto const printed = [](seq::run_report const& of) {
    std::ostringstream out;
    seq::print_summary(out, of);
    return out.str();
  };
  EXPECT_LT(printed(r).find("images to pose    p50 29.000 ms"), printed(r).find("stage "));
  EXPECT_EQ(printed(r).find("given ahead"), std::string::npos);
  EXPECT_NE(printed(r).find("tracking alone"), std::string::npos);
  EXPECT_NE(html(r).find("Images to pose"), std::string::npos);

  r.prefetch = 4;
  j = summary(r);
  EXPECT_EQ(j["prefetch"], 4);
  // The stages leave out what is computed ahead: no rate follows from them.
  EXPECT_TRUE(j["fps"].is_null());
  EXPECT_TRUE(j["processing_s"].is_null());
  EXPECT_DOUBLE_EQ(j["wall_fps"], 10);
  EXPECT_NE(printed(r).find("up to 4 frames are given ahead"), std::string::npos);
  EXPECT_EQ(printed(r).find("tracking alone"), std::string::npos);
  EXPECT_EQ(html(r).find("tracking alone"), std::string::npos);
  EXPECT_NE(html(r).find("up to 4 frames given ahead"), std::string::npos);
  EXPECT_EQ(markup_fault(html(r)), "");
}

TEST_F(report, reasons_are_counted_and_missing_figures_say_why) {
  seq::run_report r = filled(20, true);
  EXPECT_EQ(summary(r)["reasons"], nlohmann::json::object());
  EXPECT_TRUE(summary(r)["ate_rotation_missing"].is_null());
  r.records[2].reason = r.records[9].reason = "few_matches";
  r.records[3].reason = "dark";
  r.error.ate_rotation_rmse_deg.reset();
  r.error.ate_rotation_missing = "the alignment is not determined";
  nlohmann::json const j = summary(r);
  EXPECT_EQ(j["reasons"], (nlohmann::json{{"few_matches", 2}, {"dark", 1}}));
  EXPECT_EQ(j["ate_rotation_missing"], "the alignment is not determined");
  EXPECT_TRUE(j["ate_rotation_rmse_deg"].is_null());
  std::ostringstream out;
  seq::print_summary(out, r);
  EXPECT_NE(out.str().find("ATE rotation      n/a (the alignment is not determined)"),
            std::string::npos);
  EXPECT_NE(html(r).find("rotation n/a: the alignment is not determined"), std::string::npos);
}

TEST_F(report, json_means_inliers_over_tracked_frames) {
  seq::run_report r = filled(20, false);
  double sum = 0;
  for (auto const& f : r.records) { sum += f.tracked ? f.inliers : 0; }
  EXPECT_NEAR(summary(r)["mean_inliers"], sum / 18, 1e-9);
}

TEST_F(report, json_is_null_without_truth_and_without_frames) {
  nlohmann::json const j = summary(filled(20, false));
  for (char const* key : {"ate_rmse_m", "rpe_rmse_m", "truth_path_m"}) {
    EXPECT_TRUE(j[key].is_null()) << key;
  }
  EXPECT_EQ(j["pairs"], 0);
  EXPECT_DOUBLE_EQ(j["path_m"], 12.5);

  nlohmann::json const none = summary({});
  EXPECT_EQ(none["frames"], 0);
  EXPECT_TRUE(none["fps"].is_null());
  EXPECT_TRUE(none["mean_inliers"].is_null());
  EXPECT_TRUE(none["stages"].is_object());
  EXPECT_TRUE(none["options"].is_object());

  seq::run_report untimed;
  untimed.stages = {"total"};
  EXPECT_TRUE(summary(untimed)["stages"]["total"]["mean_ms"].is_null());
}

TEST_F(report, json_takes_any_bytes_and_numbers) {
  seq::run_report r = filled(5, true);
  r.title = "bytes \xff\xfe \"quoted\"";
  r.error.ate_rmse_m = nan_value;
  r.error.path_m = inf_value;
  nlohmann::json const j = summary(r);
  EXPECT_TRUE(j["ate_rmse_m"].is_null());
  EXPECT_TRUE(j["path_m"].is_number());  // measured on the estimate itself
}

// -------------------------------------------------------------------------------------------- csv

TEST_F(report, csv_has_a_row_for_each_frame) {
  seq::run_report r = filled(3, false);
  r.records[1].stage_ms = {1.5, nan_value};  // one unusable, one missing
  r.records[0].images_to_pose_ms = 5;
  r.records[1].reason = "dark";
  r.records[1].map_id = 2;
  r.records[1].warnings = {{"dark", "nearly black"}, {"two_motions", "things move"}};
  r.records[1].imu_warnings = {"samples come too late"};
  seq::write_times_csv(file("times.csv"), r);
  auto const lines = split(read_text(file("times.csv")), '\n');
  ASSERT_EQ(lines.size(), 4U);
  EXPECT_EQ(lines[0],
            "index,time_s,tracked,keyframe,keypoints,stereo_matches,inliers,local_points,fast_ms,"
            "match_ms,"
            "total_ms,images_to_pose_ms,reason,map_id,warnings");
  EXPECT_EQ(lines[1],
            "0,1403636579.763555584,1,1,1000,600,200,800,1.000000,2.000000,4.000000,5.000000,,0,");
  EXPECT_EQ(lines[2],
            "1,1403636579.813555584,1,0,1000,600,201,800,1.500000,,,,dark,2,dark two_motions imu");
  for (auto const& line : lines) {
    EXPECT_EQ(std::count(line.begin(), line.end(), ','), 14) << line;
  }
}

TEST_F(report, csv_has_the_covariances_that_are_known) {
  seq::run_report r = filled(2, false);
  for (int i = 0; i < 21; ++i) { r.records[0].covariance.push_back(0.5 + 1e-7 * i); }
  seq::write_times_csv(file("times.csv"), r);
  auto const lines = split(read_text(file("times.csv")), '\n');
  ASSERT_EQ(lines.size(), 3U);
  EXPECT_NE(lines[0].find(",covariance_00,covariance_01,"), std::string::npos);
  EXPECT_NE(lines[0].find(",covariance_05,covariance_11,"), std::string::npos);
  EXPECT_NE(lines[0].find(",covariance_45,covariance_55,images_to_pose_ms,"), std::string::npos);
  EXPECT_NE(lines[1].find(",0.5,0.5000001,"), std::string::npos);
  EXPECT_NE(lines[1].find(",0.5000019,0.500002,"), std::string::npos);
  EXPECT_NE(lines[2].find(std::string(21, ',')), std::string::npos);
  for (auto const& line : lines) {
    EXPECT_EQ(std::count(line.begin(), line.end(), ','), 14 + 21) << line;
  }
}

TEST_F(report, csv_quotes_names_and_keeps_signs) {
  seq::run_report r;
  r.stages = {"a,\"b\""};
  r.records.resize(1);
  r.records[0].time_ns = -1'500'000'000;
  seq::write_times_csv(file("times.csv"), r);
  auto const lines = split(read_text(file("times.csv")), '\n');
  ASSERT_EQ(lines.size(), 2U);
  EXPECT_NE(lines[0].find(",\"a,\"\"b\"\"_ms\""), std::string::npos);
  EXPECT_EQ(lines[1].rfind("0,-1.500000000,0,0,", 0), 0U);
}

// ------------------------------------------------------------------------------------------- html

TEST_F(report, the_markup_check_finds_faults) {
  auto const with = [](std::string const& body) { return "<style></style><p>" + body + "</p>"; };
  EXPECT_EQ(markup_fault(with("<rect x=\"1\" y=\"-2.5\"/>")), "");
  EXPECT_EQ(markup_fault(with("<script>var a=[1,{b:\")\"}];</script>")), "");
  for (char const* bad :
       {"<b>", "</b>", "<rect x=\"nan\"/>", "<rect x=\"-inf\"/>", "<path d=\"M1 nan\"/>",
        "<path d=\"\"/>", "<script src=\"a.js\"></script>", "<a href=\"http://a.b\"></a>",
        "<a & b=c></a>", "< <b></b>", "<script>var a=[1,2;</script>", "<script>fetch(1)</script>",
        "<script>a</script><script>b</script>", "<script>var a=NaN;</script>",
        "<script defer>a</script>"}) {
    EXPECT_NE(markup_fault(with(bad)), "") << bad;
  }
}

TEST_F(report, html_of_an_empty_report) {
  std::string const text = html({});
  EXPECT_EQ(markup_fault(text), "");
  EXPECT_NE(text.find("n/a"), std::string::npos);
  EXPECT_NE(text.find("No frame was processed."), std::string::npos);
  EXPECT_EQ(count(text, "<image"), 0);
}

TEST_F(report, html_of_a_filled_report) {
  seq::run_report r = filled(120, true);
  add_sample(r, 64, 48, 50);
  add_sample(r, 64, 48, 0);
  std::string const text = html(r);
  EXPECT_EQ(markup_fault(text), "");
  EXPECT_EQ(count(text, "<svg"), count(text, "</svg>"));
  EXPECT_EQ(count(text, "http"), 0);
  EXPECT_EQ(count(text, "<script"), 1);
  EXPECT_EQ(count(text, "<image"), 2);
  EXPECT_EQ(count(text, "data:image/jpeg;base64,/9j/"), 2);  // FF D8 FF: a JPEG
  for (char const* words :
       {"Trajectory", "ground truth", "Position error over time", "Time per frame",
        "Time per stage", "Keypoints and inliers", "Keypoints and tracks", "Options"}) {
    EXPECT_NE(text.find(words), std::string::npos) << words;
  }
  EXPECT_NE(text.find("The axis is cut"), std::string::npos);  // frame 3 took 400 ms
  EXPECT_GE(count(text, "<circle"), 50);
}

TEST_F(report, html_without_truth_has_no_error_chart) {
  std::string const text = html(filled(40, false));
  EXPECT_EQ(markup_fault(text), "");
  EXPECT_EQ(text.find("Position error over time"), std::string::npos);
  EXPECT_NE(text.find("no ground truth"), std::string::npos);
}

TEST_F(report, html_of_odd_reports) {
  seq::run_report none_tracked = filled(30, true);
  none_tracked.estimate.clear();
  none_tracked.tracked = 0;
  none_tracked.error = {};
  for (auto& f : none_tracked.records) { f.tracked = false; }
  EXPECT_EQ(markup_fault(html(none_tracked)), "");

  seq::run_report standing = filled(30, true);
  for (auto* poses : {&standing.estimate, &standing.truth}) {
    for (auto& p : *poses) { p.T_world_camera.translation().setZero(); }
  }
  EXPECT_EQ(markup_fault(html(standing)), "");

  seq::run_report one = filled(1, true);
  add_sample(one, 16, 16, 3);
  EXPECT_EQ(markup_fault(html(one)), "");

  seq::run_report untimed = filled(10, false);
  for (auto& f : untimed.records) { f.stage_ms.clear(); }
  EXPECT_EQ(markup_fault(html(untimed)), "");

  seq::run_report stages_only;
  stages_only.stages = {"total"};
  EXPECT_EQ(markup_fault(html(stages_only)), "");

  for (double const far : {1e12, 1e18, 1e200}) {  // a run that diverged
    seq::run_report diverged = filled(30, true);
    for (auto& p : diverged.estimate) { p.T_world_camera.translation().x() += far; }
    EXPECT_EQ(markup_fault(html(diverged)), "") << far;
    diverged.truth.clear();
    EXPECT_EQ(markup_fault(html(diverged)), "") << far;
  }

  seq::run_report apart = filled(10, true);  // truth of another day
  for (auto& p : apart.truth) { p.time_ns -= 86'400'000'000'000LL; }
  apart.error = {};
  EXPECT_EQ(markup_fault(html(apart)), "");
}

TEST_F(report, html_never_prints_what_is_not_finite) {
  seq::run_report r = filled(50, true);
  add_sample(r, 32, 32, 20);
  r.error.path_m = nan_value;
  r.error.ate_rmse_m = inf_value;
  r.error.truth_path_m = nan_value;
  r.estimate[3].T_world_camera.translation().y() = nan_value;
  r.truth[7].T_world_camera.translation().x() = inf_value;
  r.records[4].stage_ms[2] = nan_value;
  r.records[5].stage_ms[0] = inf_value;
  auto& points = r.samples[0].keypoints;
  points[0].x = std::numeric_limits<float>::quiet_NaN();
  points[1].depth = std::numeric_limits<float>::infinity();
  points[2].size = std::numeric_limits<float>::quiet_NaN();
  points[4].from_x = std::numeric_limits<float>::infinity();
  std::string const text = html(r);
  EXPECT_EQ(markup_fault(text), "");
  std::string page = text;  // without the pictures' letters
  for (std::size_t at = 0; (at = page.find("base64,", at)) != std::string::npos; at += 7) {
    page.erase(at + 7, page.find('"', at) - at - 7);
  }
  EXPECT_FALSE(has_word(page, "nan"));
  EXPECT_FALSE(has_word(page, "inf"));
}

TEST_F(report, html_escapes_text) {
  seq::run_report r = filled(5, false);
  r.title = "<b>a & \"b\"</b>";
  r.options["<x>"] = "1 < 2 && 'y'";
  r.stages[0] = "f<a>st";
  std::string const text = html(r);
  EXPECT_EQ(markup_fault(text), "");
  EXPECT_EQ(text.find("<b>a"), std::string::npos);
  EXPECT_NE(text.find("&lt;b&gt;a &amp; &quot;b&quot;&lt;/b&gt;"), std::string::npos);
  EXPECT_NE(text.find("1 &lt; 2 &amp;&amp; &#39;y&#39;"), std::string::npos);
  EXPECT_NE(text.find("f&lt;a&gt;st"), std::string::npos);
}

// Everything at its largest: 5000 frames, 16 stages, pictures of pure noise, the worst there are.
TEST_F(report, html_has_at_most_a_megabyte) {
  seq::run_report r = filled(5000, true);
  r.stages.clear();
  for (int s = 0; s < 15; ++s) { r.stages.push_back("stage " + std::to_string(s)); }
  r.stages.emplace_back("total");
  for (std::size_t i = 0; i < r.records.size(); ++i) {
    r.records[i].stage_ms.assign(16, 0.1 + 0.01 * static_cast<double>(i % 7));
  }
  add_cloud(r, 100'000);
  std::string const charts = html(r);
  EXPECT_EQ(markup_fault(charts), "");
  EXPECT_LT(charts.size(), 600'000U);
  for (int i = 0; i < 8; ++i) { add_sample(r, 1392, 512, 2000); }
  std::string const text = html(r);
  EXPECT_EQ(markup_fault(text), "");
  EXPECT_LE(text.size(), 1'000'000U);
  EXPECT_EQ(count(text, "<image"), 8);
  for (auto& sample : r.samples) {
    for (int i = 0; i < 6; ++i) {  // 128,000 keypoints each
      sample.keypoints.insert(sample.keypoints.end(), sample.keypoints.begin(),
                              sample.keypoints.end());
    }
  }
  std::string const many = html(r);
  EXPECT_LE(many.size(), 1'000'000U);
  EXPECT_EQ(count(many, "<image"), 8);
  EXPECT_GE(count(many, "<circle"), 5000);
}

TEST_F(report, html_draws_path_and_map_in_space) {
  seq::run_report r = filled(200, true);
  add_cloud(r, 500);
  std::string const text = html(r);
  EXPECT_EQ(markup_fault(text), "");
  EXPECT_NE(text.find("Path and map in space"), std::string::npos);
  std::string const script = script_of(text);
  for (char const* name : {"cloud=[[", "truth=[[", "estimate=[[", "ends=[["}) {
    EXPECT_NE(script.find(name), std::string::npos) << name;
  }
  // each point three numbers; a few that lie apart from the rest may be left out
  std::size_t const begin = script.find("cloud=[[") + 8;
  std::string const cloud = script.substr(begin, script.find(']', begin) - begin);
  int const numbers = count(cloud, ",") + 1;
  EXPECT_EQ(numbers % 3, 0);
  EXPECT_GE(numbers / 3, 450);
  EXPECT_LE(numbers / 3, 500);
  // what is drawn without the script is as much
  std::size_t const drawing = text.find("<path class=\"cloud\" d=\"");
  ASSERT_NE(drawing, std::string::npos);
  std::string const dots = text.substr(drawing, text.find("/>", drawing) - drawing);
  EXPECT_EQ(count(dots, "M"), numbers / 3);

  seq::run_report nothing = filled(20, false);
  nothing.estimate.clear();
  EXPECT_EQ(html(nothing).find("<script"), std::string::npos);
}

// A square of 2 m seen at the same time from all four corners: the alignment to the ground truth
// moves the map as it moves the path.
TEST_F(report, html_moves_the_map_with_the_path) {
  seq::run_report r;
  for (int i = 0; i < 4; ++i) {
    seq::stamped_pose p;
    p.time_ns = i * std::int64_t{50'000'000};
    p.T_world_camera.translation() = Eigen::Vector3d(i % 2 * 2, 0, i / 2 * 2);
    r.estimate.push_back(p);
    r.cloud.push_back(p.T_world_camera.translation().cast<float>());
  }
  auto const numbers = [](std::string const& script, std::string const& name) {
    std::size_t const at = script.find(name + "=[[") + name.size() + 3;
    return script.substr(at, script.find(']', at) - at);
  };
  std::string const alone = script_of(html(r));
  EXPECT_EQ(numbers(alone, "cloud"), numbers(alone, "estimate"));
  r.truth = r.estimate;
  for (auto& p : r.truth) { p.T_world_camera.translation() += Eigen::Vector3d(100, 20, -7); }
  r.error.T_truth_estimate.translation() = Eigen::Vector3d(100, 20, -7);
  std::string const moved = script_of(html(r));
  EXPECT_EQ(numbers(moved, "cloud"), numbers(moved, "estimate"));
  EXPECT_EQ(numbers(moved, "cloud"), numbers(moved, "truth"));
  EXPECT_EQ(numbers(moved, "cloud"), numbers(alone, "cloud"));
  // corners of the drawn box: right, forward, up
  EXPECT_EQ(numbers(alone, "cloud"), "-1000,-1000,0,1000,-1000,0,-1000,1000,0,1000,1000,0");
}

TEST_F(report, html_has_the_rotation_error) {
  std::string const text = html(filled(60, true));
  EXPECT_NE(text.find("Rotation error over time"), std::string::npos);
  EXPECT_NE(text.find("rotation 1.50\xc2\xb0"), std::string::npos);
  EXPECT_NE(text.find("rotation 0.750\xc2\xb0"), std::string::npos);
  seq::run_report positions = filled(60, true);
  positions.error.ate_rotation_rmse_deg.reset();
  positions.error.rpe_rotation_rmse_deg.reset();
  EXPECT_EQ(html(positions).find("Rotation error over time"), std::string::npos);
}

TEST_F(report, warnings_and_stop_are_in_all_outputs) {
  seq::run_report r = filled(20, true);
  r.stopped_at = 20;
  r.stopped_by = "SIGINT";
  r.warnings = {"stopped at frame 20: SIGINT", "a <b> & \"c\""};
  nlohmann::json const j = summary(r);
  EXPECT_EQ(j["warnings"], r.warnings);
  EXPECT_EQ(j["stopped_at"], 20);
  EXPECT_EQ(j["stopped_by"], "SIGINT");
  std::string const text = html(r);
  EXPECT_EQ(markup_fault(text), "");
  EXPECT_NE(text.find("<li>stopped at frame 20: SIGINT</li>"), std::string::npos);
  EXPECT_NE(text.find("a &lt;b&gt; &amp; &quot;c&quot;"), std::string::npos);
  std::ostringstream out;
  seq::print_summary(out, r);
  EXPECT_NE(out.str().find("warning: a <b> & \"c\""), std::string::npos);

  nlohmann::json const whole = summary(filled(20, true));
  EXPECT_TRUE(whole["warnings"].empty());
  EXPECT_TRUE(whole["stopped_at"].is_null());
  EXPECT_EQ(html(filled(20, true)).find("<li>"), std::string::npos);
}

TEST_F(report, evo_commands_fit_the_figures) {
  seq::run_report r = filled(60, true);
  auto const command = [](nlohmann::json const& j, char const* figure) {
    return j["evo"][figure]["command"].get<std::string>();
  };
  nlohmann::json j = summary(r);
  EXPECT_EQ(command(j, "ATE RMSE"), "evo_ape tum groundtruth.txt trajectory.txt --align");
  EXPECT_EQ(command(j, "RPE RMSE over 1 s"),
            "evo_rpe tum groundtruth.txt trajectory.txt --delta 20 --delta_unit f --all_pairs");
  EXPECT_TRUE(j["evo"]["RPE RMSE over 1 s"]["exact"]);
  EXPECT_NE(html(r).find("evo_ape tum"), std::string::npos);

  r.error.rpe_rotation_rmse_deg.reset();  // positions alone
  r.error.rpe_span.reset();               // frames lost: 54 poses in 2.9 s
  j = summary(r);
  EXPECT_NE(command(j, "RPE RMSE over 1 s").find("--pose_relation point_distance"),
            std::string::npos);
  EXPECT_NE(command(j, "RPE RMSE over 1 s").find("--delta 18 "), std::string::npos);
  EXPECT_FALSE(j["evo"]["RPE RMSE over 1 s"]["exact"]);
  EXPECT_NE(html(r).find("about: evo counts poses"), std::string::npos);

  EXPECT_TRUE(summary(filled(60, false))["evo"].empty());
  EXPECT_EQ(html(filled(60, false)).find("evo_"), std::string::npos);
}

TEST_F(report, wall_clock_counts_reading) {
  seq::run_report r = filled(50, false);
  r.wall_s = 2.5;
  EXPECT_DOUBLE_EQ(summary(r)["wall_fps"], 20);
  std::ostringstream out;
  seq::print_summary(out, r);
  EXPECT_NE(out.str().find("2.5 s, 20.0 frames/s"), std::string::npos);
  EXPECT_TRUE(summary(filled(50, false))["wall_fps"].is_null());
}

TEST_F(report, html_leaves_out_broken_samples) {
  seq::run_report r = filled(5, false);
  r.samples.resize(2);
  r.samples[1].picture.width = 10;
  r.samples[1].picture.height = 10;  // and no pixels
  std::string const text = html(r);
  EXPECT_EQ(markup_fault(text), "");
  EXPECT_EQ(count(text, "<image"), 0);
}

// ------------------------------------------------------------------------------------------ errors

TEST_F(report, unwritable_paths_throw) {
  std::string const path = file("no/such/folder/file");
  seq::run_report const r = filled(3, false);
  EXPECT_THROW(seq::write_html(path, r), seq::error);
  EXPECT_THROW(seq::write_times_csv(path, r), seq::error);
  try {
    seq::write_summary_json(path, r);
    ADD_FAILURE() << "no exception";
  } catch (seq::error const& e) { EXPECT_NE(std::string(e.what()).find(path), std::string::npos); }
}

TEST_F(report, a_full_disk_throws) {
  if (!std::filesystem::exists("/dev/full")) { GTEST_SKIP() << "no /dev/full"; }
  EXPECT_THROW(seq::write_html("/dev/full", filled(3, false)), seq::error);
}

// --------------------------------------------------------------------------------------- terminal

TEST_F(report, summary_table_is_aligned) {
  std::ostringstream out;
  out.precision(3);
  seq::print_summary(out, filled(20, true));
  std::string const text = out.str();
  std::vector<std::size_t> widths;
  for (std::string const& line : split(text, '\n')) {
    for (char const* start : {"  stage", "  fast ", "  match ", "  total "}) {
      if (line.rfind(start, 0) == 0) { widths.push_back(line.size()); }
    }
  }
  ASSERT_EQ(widths.size(), 4U);
  for (std::size_t const w : widths) { EXPECT_EQ(w, widths[0]); }
  EXPECT_NE(text.find("0.0500 m"), std::string::npos);
  EXPECT_NE(text.find("400.000"), std::string::npos);
  EXPECT_EQ(text.find("n/a"), std::string::npos);
  EXPECT_EQ(out.precision(), 3);  // the stream is left as it was
}

TEST_F(report, summary_says_where_there_is_no_value) {
  std::ostringstream out;
  seq::print_summary(out, {});
  EXPECT_NE(out.str().find("ATE RMSE          n/a (no ground truth)"), std::string::npos);
  EXPECT_NE(out.str().find("throughput        n/a"), std::string::npos);
  EXPECT_EQ(out.str().find("nan"), std::string::npos);
}

TEST_F(report, progress_prints_a_line_every_ten_percent) {
  std::ostringstream out;
  seq::progress p(out, false, "track", 300);
  for (int i = 1; i <= 300; ++i) { p.step(i, i == 30 ? "note" : ""); }
  p.finish();
  auto const lines = split(out.str(), '\n');
  ASSERT_EQ(lines.size(), 10U);
  EXPECT_EQ(lines[0].rfind("track  30/300  10 %", 0), 0U);
  EXPECT_NE(lines[0].find("  note"), std::string::npos);
  EXPECT_EQ(lines[9].rfind("track  300/300  100 %", 0), 0U);
  EXPECT_EQ(lines[9].find("ETA"), std::string::npos);
  EXPECT_EQ(out.str().find('\r'), std::string::npos);
}

TEST_F(report, progress_takes_odd_totals) {
  for (int const total : {0, -1, 1, 3, std::numeric_limits<int>::max()}) {
    std::ostringstream out;
    seq::progress p(out, false, "x", total);
    p.step(0);
    p.step(1);
    p.step(5);
    p.finish();
    EXPECT_EQ(out.str().find("nan"), std::string::npos) << total;
    EXPECT_LE(split(out.str(), '\n').size(), 3U) << total;
  }
}

TEST_F(report, progress_redraws_seldom_on_a_terminal) {
  std::ostringstream out;
  seq::progress p(out, true, "track", 1000);
  for (int i = 1; i <= 1000; ++i) { p.step(i); }
  // well under a second passes here: the first, the last, and at most ten a second between
  int const early = count(out.str(), "\r");
  EXPECT_GE(early, 2);
  EXPECT_LE(early, 12);
  EXPECT_EQ(out.str().find('\n'), std::string::npos);
  EXPECT_NE(out.str().find("1000/1000  100 %"), std::string::npos);
  p.finish();
  p.finish();
  EXPECT_EQ(count(out.str(), "\n"), 1);

  std::ostringstream slow;
  seq::progress q(slow, true, "track", 10);
  q.step(1);
  std::this_thread::sleep_for(std::chrono::milliseconds(120));
  q.step(2);
  EXPECT_EQ(count(slow.str(), "\r"), 2);
  EXPECT_NE(slow.str().find("ETA"), std::string::npos);
}

}  // namespace
