// SPDX-License-Identifier: Apache-2.0
/// @file The sections of the HTML report, one file each. Not API: included by report_html.cpp and
/// the sections only.
#pragma once

#include <cstddef>
#include <string>

#include "examples/sequence/report.hpp"
#include "examples/sequence/report_figures.hpp"

namespace seq::detail {

std::string trajectory_section(run_report const& r, run_figures const& f);
/// Path and map points in three dimensions, with the page's only script, which turns them. Empty
/// without poses.
std::string space_section(run_report const& r);
/// Position and rotation error over time. Empty without ground truth.
std::string error_section(run_report const& r, run_figures const& f);
/// The stages stacked over the frames. @pre at most stage_palette.size() stages before the last
std::string time_section(run_report const& r, run_figures const& f);
/// @pre as time_section
std::string stage_table(run_figures const& f);
/// With the warnings of frames below, on the same axis.
std::string counts_section(run_report const& r);
/// A strip for each name of a warning that frames have. Empty without any.
std::string warning_strips(run_report const& r);
/// Velocity and biases over time. Empty without an IMU.
std::string imu_section(run_report const& r);
/// Pictures with keypoints; empty without samples. Where there are many keypoints, some of them.
/// @param budget bytes that the section should have at most; the pictures get what the rest leaves
std::string sample_section(run_report const& r, std::size_t budget);

/// All of the page's CSS: colours are variables, which dark mode redefines.
std::string style_sheet();

}  // namespace seq::detail
