// SPDX-License-Identifier: Apache-2.0
#include <algorithm>
#include <cmath>
#include <cstddef>
#include <optional>
#include <string>

#include "examples/sequence/report.hpp"
#include "examples/sequence/report_figures.hpp"
#include "examples/sequence/report_markup.hpp"
#include "examples/sequence/report_palette.hpp"
#include "examples/sequence/report_sections.hpp"

// The report is one HTML file: figures are inline SVG, pictures base64 JPEG. The one script turns
// the drawing in space, which is there without it.
// Colours of charts are CSS classes, so that dark mode and print only redefine variables. Every
// element except <meta> and <br> is closed, which the test checks.

namespace seq {
namespace {

using detail::escape;
using detail::fixed;
using detail::grouped;
using detail::run_figures;
using detail::significant;

std::string card(std::string const& name, std::string const& value, std::string const& unit,
                 std::string const& note, char const* style = "") {
  std::string out = std::string("<div class=\"card ") + style + "\"><div class=\"name\">" +
                    escape(name) + "</div><div class=\"value\">" + escape(value);
  if (!unit.empty() && value != "n/a") {
    out += "<span class=\"unit\"> " + escape(unit) + "</span>";
  }
  return out + "</div><div class=\"note\">" + escape(note) + "</div></div>\n";
}

std::string length_text(double metres) {
  return std::isfinite(metres) ? significant(metres) : "n/a";
}

std::string axes_note(trajectory_error const& e) {
  if (!e.ate_axes_m) { return {}; }
  auto const& a = *e.ate_axes_m;
  return "; along x, y, z " + significant(a.x()) + ", " + significant(a.y()) + ", " +
         significant(a.z());
}

std::string rotation_note(std::optional<double> const& degrees) {
  return degrees ? "; rotation " + significant(*degrees) + "\xc2\xb0" : std::string();
}

std::string cards(run_report const& r, run_figures const& f) {
  std::string out = "<div class=\"cards\">\n";
  char const* state = !f.tracked_ratio          ? ""
                      : *f.tracked_ratio > 0.98 ? "good"
                      : *f.tracked_ratio > 0.8  ? "fair"
                                                : "bad";
  out += card(
      "Tracked", tracked_percent(f), "%",
      grouped(r.tracked) + " of " + grouped(r.frames) + " frames, " + grouped(r.lost) + " lost" +
          (r.dropped > 0 ? ", " + grouped(r.dropped) + " dropped" : "") +
          (f.without_scale > 0 ? "; " + grouped(f.without_scale) + " before the scale was known"
                               : ""),
      state);
  std::string const no_truth = "no ground truth";
  out += card("Absolute error", f.ate_rmse_m ? significant(*f.ate_rmse_m) : "n/a", "m",
              f.ate_rmse_m ? "ATE RMSE over " + grouped(r.error.pairs) + " poses" +
                                 (r.scale ? ", scaled to the ground truth" : "") +
                                 axes_note(r.error) + rotation_note(f.ate_rotation_rmse_deg) +
                                 (r.error.ate_rotation_missing.empty()
                                      ? ""
                                      : "; rotation n/a: " + r.error.ate_rotation_missing)
              : f.has_truth ? "too few poses with ground truth"
                            : no_truth);
  out += card("Relative error", f.rpe_rmse_m ? significant(*f.rpe_rmse_m) : "n/a", "m",
              f.rpe_rmse_m
                  ? "RPE RMSE over 1 s" + rotation_note(f.rpe_rotation_rmse_deg) +
                        (r.error.drift_percent ? "; drift " + significant(*r.error.drift_percent) +
                                                     " % of a tenth of the path"
                                               : "")
              : f.has_truth ? "too few poses with ground truth"
                            : no_truth);
  std::string path_note = r.metric || r.scale ? "estimated" : "estimated, of unknown scale";
  if (r.fit) { path_note += "; x " + significant(r.fit->scale) + " would fit the truth best"; }
  if (f.has_truth && std::isfinite(r.error.truth_path_m) && r.error.truth_path_m > 0) {
    path_note += "; ground truth " + length_text(r.error.truth_path_m) + " m";
  }
  out += card("Path", r.estimate.empty() && f.path_m <= 0 ? "n/a" : length_text(f.path_m),
              r.metric || r.scale ? "m" : "", path_note);
  bool const timed = f.images_to_pose.count > 0;
  out += card("Images to pose", timed ? significant(f.images_to_pose.ms.p50) : "n/a", "ms",
              !timed ? "not timed"
                     : "median; p99 " + significant(f.images_to_pose.ms.p99) + " ms" +
                           (r.prefetch > 0 ? "; up to " + std::to_string(r.prefetch) +
                                                 " frames given ahead wait for their turn"
                                           : ""));
  if (r.prefetch > 0) {
    out += card("Throughput", f.wall_fps ? significant(*f.wall_fps) : "n/a", "frames/s",
                f.wall_fps ? "wall clock, reading and decoding included" : "not timed");
  } else {
    out += card("Throughput", f.fps ? significant(*f.fps) : "n/a", "frames/s",
                !f.processing_s ? "not timed"
                : f.wall_fps    ? "tracking alone; wall clock " + significant(*f.wall_fps)
                                : fixed(*f.processing_s, 1) + " s of processing");
  }
  out +=
      card("Inliers", f.mean_inliers ? fixed(*f.mean_inliers, 0) : "n/a", "",
           f.mean_keypoints ? "mean, of " + grouped(std::llround(*f.mean_keypoints)) + " keypoints"
                            : "mean per tracked frame");
  out += card("Map", grouped(r.map_points), "points", grouped(r.keyframes) + " keyframes");
  return out + "</div>\n";
}

std::string table_row(std::string const& name, std::string const& value) {
  return "<tr><th>" + escape(name) + "</th><td>" + escape(value.empty() ? "n/a" : value) +
         "</td></tr>\n";
}

std::string warning_section(run_report const& r) {
  if (r.warnings.empty()) { return {}; }
  std::string out =
      "<section class=\"warnings\">\n<h2>Is the result right?</h2>\n<ul class=\"list\">\n";
  for (std::string const& warning : r.warnings) { out += "<li>" + escape(warning) + "</li>\n"; }
  return out + "</ul>\n</section>\n";
}

std::string evo_table(run_report const& r, run_figures const& f) {
  auto const commands = detail::evo_commands(r, f);
  if (commands.empty()) { return {}; }
  std::string out =
      "<h3>The same figures by evo, in this folder</h3><table class=\"plain\"><tbody>\n";
  for (detail::evo_command const& c : commands) {
    out +=
        table_row(c.figure + (c.exact ? "" : ", about: evo counts poses, not seconds"), c.command);
  }
  return out + "</tbody></table>";
}

std::string options_section(run_report const& r, run_figures const& f) {
  std::string out = detail::section_open("Run", "");
  out += "<div class=\"columns\">\n<div><h3>Environment</h3><table class=\"plain\"><tbody>\n";
  out += table_row("sequence", r.sequence);
  out += table_row("backend", r.backend);
  out += table_row("device", r.device);
  out += table_row("image size", r.image_width > 0 && r.image_height > 0
                                     ? std::to_string(r.image_width) + " \xc3\x97 " +
                                           std::to_string(r.image_height)
                                     : "n/a");
  if (r.threads > 0) { out += table_row("threads", std::to_string(r.threads)); }
  out += table_row("ft", r.version);
  out += table_row("date", r.date);
  out += table_row("command", r.command);
  out += table_row("poses", "of the " + r.frame);
  out += table_row("frames", grouped(r.frames));
  out += table_row("lost", grouped(r.lost));
  out += table_row("dropped", grouped(r.dropped));
  out += "</tbody></table></div>\n<div><h3>Options</h3>";
  if (r.options.empty()) {
    out += detail::nothing("No options were recorded.");
  } else {
    out += "<table class=\"plain\"><tbody>\n";
    for (auto const& [name, value] : r.options) { out += table_row(name, value); }
    out += "</tbody></table>";
  }
  return out + "</div>\n</div>" + evo_table(r, f) + "</section>\n";
}

}  // namespace

void write_html(std::string const& path, run_report const& report) {
  // the last one is the whole frame
  if (report.stages.size() > detail::stage_palette.size() + 1) {
    throw error(path + ": " + std::to_string(report.stages.size() - 1) +
                " stages before the last; the report has colours for " +
                std::to_string(detail::stage_palette.size()));
  }
  run_figures const f = detail::figures_of(report);
  std::string const title = report.title.empty() ? "Tracking report" : report.title;
  std::string out =
      "<!DOCTYPE html>\n<html lang=\"en\">\n<head>\n<meta charset=\"utf-8\">\n"
      "<meta name=\"viewport\" content=\"width=device-width, initial-scale=1\">\n";
  out += "<title>" + escape(title) + "</title>\n<style>" + detail::style_sheet() +
         "</style>\n</head>\n";
  out += "<body>\n<main>\n<header>\n<h1>" + escape(title) + "</h1>\n<p class=\"lead\">";
  std::string const size =
      report.image_width > 0 && report.image_height > 0
          ? std::to_string(report.image_width) + " \xc3\x97 " + std::to_string(report.image_height)
          : "";
  for (std::string const& fact : {report.sequence, report.backend, report.device, size}) {
    if (!fact.empty()) { out += "<span>" + escape(fact) + "</span>"; }
  }
  out += "</p>\n</header>\n";
  out += warning_section(report);
  out += cards(report, f);
  out += detail::trajectory_section(report, f);
  out += detail::space_section(report);
  out += detail::error_section(report, f);
  out += detail::time_section(report, f);
  out += detail::stage_table(f);
  out += detail::counts_section(report);
  out += detail::imu_section(report);
  std::string const rest =
      options_section(report, f) +
      "<footer>Written by FastTrack. Self-contained: nothing is loaded from elsewhere.</footer>"
      "\n</main>\n</body>\n</html>\n";
  constexpr std::size_t most_bytes = 1'000'000;
  std::size_t const used = out.size() + rest.size();
  out += detail::sample_section(report, most_bytes - std::min(used, most_bytes)) + rest;
  detail::write_text(path, out);
}

}  // namespace seq
