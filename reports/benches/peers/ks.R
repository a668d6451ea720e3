# A loop over R's exact test: neighbouring samples of a file with one sample a line. Prints the seconds that the loop took,
# then a p-value a line.
path <- commandArgs(trailingOnly = TRUE)[1]
samples <- lapply(strsplit(readLines(path), ","), as.numeric)
invisible(ks.test(samples[[1]], samples[[2]], exact = TRUE))
p <- numeric(length(samples) - 1)
begin <- proc.time()[["elapsed"]]
for (i in seq_along(p)) p[i] <- ks.test(samples[[i]], samples[[i + 1]], exact = TRUE)$p.value
cat(proc.time()[["elapsed"]] - begin, "\n")
cat(format(p, digits = 17), sep = "\n")
