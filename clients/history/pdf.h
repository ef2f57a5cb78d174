#pragma once

#include <string>

/// A page as a printable file.
namespace secondskin::history {

/// Turns an HTML page into PDF with WeasyPrint (Debian package weasyprint), a program of its own.
/// The page goes to it and comes back in memory: no file of it lies about.
/// @throws std::runtime_error when it is not installed (then how to get it), or what it said.
std::string pdf_of(const std::string& html);

}  // namespace secondskin::history
