#pragma once

#include <span>
#include <string>

#include "clients/history/progress.h"

/// Plots as inline SVG, for paper: told apart by shape as well as by colour, 0 to 100 always whole.
namespace secondskin::history {

/// Mean score of each block over time; where all is of two days at most, in order. Bars: standard
/// deviation of the repetitions.
std::string score_plot(std::span<const ProgressPoint> points);

/// The error of each joint in the first and in the last block, the largest first; at most twelve.
std::string joint_plot(const ProgressPoint& first, const ProgressPoint& last);

/// For use in HTML and SVG, as text or attribute.
std::string escaped(const std::string& text);

/// "left_knee" as people say it.
std::string spoken(const std::string& name);

}  // namespace secondskin::history
