#include "clients/dashboard/static_files.h"

#include <gtest/gtest.h>
#include <unistd.h>

#include <fstream>

namespace secondskin::dashboard {
namespace {

namespace fs = std::filesystem;

class StaticFilesTest : public testing::Test {
 protected:
  StaticFilesTest() {
    std::string name = (fs::temp_directory_path() / "secondskin_XXXXXX").string();
    root_ = ::mkdtemp(name.data());
    fs::create_directories(root_ / "page" / "assets");
    write("page/index.html", "<html>");
    write("page/assets/app-1a2b.js", "go()");
    write("secret.txt", "secret");
    fs::create_symlink(root_ / "secret.txt", root_ / "page" / "link.txt");
  }
  ~StaticFilesTest() override { fs::remove_all(root_); }
  void write(const std::string& name, const std::string& text) {
    std::ofstream(root_ / name) << text;
  }
  fs::path root_;
};

TEST_F(StaticFilesTest, ServesThePageWithItsTypes) {
  const StaticFiles files(root_ / "page");
  const auto index = files.find("/");
  ASSERT_TRUE(index);
  EXPECT_EQ(index->body, "<html>");
  EXPECT_EQ(index->content_type, "text/html; charset=utf-8");
  EXPECT_FALSE(index->immutable);
  const auto script = files.find("/assets/app-1a2b.js");
  ASSERT_TRUE(script);
  EXPECT_EQ(script->content_type, "text/javascript; charset=utf-8");
  EXPECT_TRUE(script->immutable);
  EXPECT_NE(script->etag, index->etag);
}

TEST_F(StaticFilesTest, ReadsNothingOutsideItsFolder) {
  const StaticFiles files(root_ / "page");
  for (const std::string path :
       {"/../secret.txt", "/assets/../../secret.txt", "/link.txt", "//etc/passwd", "/..", "/assets",
        "/assets/", "", "index.html", "/..\\secret.txt"}) {
    EXPECT_FALSE(files.find(path)) << path;
  }
  EXPECT_FALSE(files.find(std::string_view("/index.html\0.txt", 16)));
  EXPECT_FALSE(StaticFiles("").find("/"));
  EXPECT_FALSE(StaticFiles(root_ / "none").built());
}

TEST_F(StaticFilesTest, ANewBuildIsAnotherVersion) {
  const StaticFiles files(root_ / "page");
  const std::string before = files.version();
  write("page/index.html", "<html>new");
  EXPECT_NE(files.version(), before);
  EXPECT_EQ(StaticFiles(root_ / "none").version(), "");
}

TEST(Target, IsDecodedOnce) {
  const auto target = parse_target("/api/references/a%2Bb%2520?token=x%26y&note=a+b&empty");
  ASSERT_TRUE(target);
  EXPECT_EQ(target->path, "/api/references/a+b%20");
  EXPECT_EQ(target->query.at("token"), "x&y");
  EXPECT_EQ(target->query.at("note"), "a b");
  EXPECT_EQ(target->query.at("empty"), "");
  for (const char* bad : {"", "x", "http://a/", "/%", "/%2", "/%zz", "/?a=%g1"}) {
    EXPECT_FALSE(parse_target(bad)) << bad;
  }
}

}  // namespace
}  // namespace secondskin::dashboard
