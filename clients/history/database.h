#pragma once

#include <SQLiteCpp/Database.h>

#include <filesystem>
#include <span>

/// How a history's file is opened, checked and brought to the present version.
namespace secondskin::history {

/// The statements that lead from each version to the next; the first makes all from nothing.
std::span<const char* const> migrations() noexcept;

/// Opens or makes the file (folder 0700 if it is new, file 0600), checks that it is a whole history
/// and applies the migrations that it has not had, all in one transaction.
/// @throws std::runtime_error naming the file and what was expected. Nothing was written then.
SQLite::Database open_database(const std::filesystem::path& file,
                               std::span<const char* const> migrations);

}  // namespace secondskin::history
