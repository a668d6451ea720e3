//! Public series whose changes are known, for what finds changes. The main type is [`PublicSeries`].

/// A series that others have published, and what is known of its changes.
#[derive(Debug, Clone, PartialEq)]
pub struct PublicSeries {
    /// Its name in tables.
    pub name: &'static str,
    /// When it changed, and why.
    pub known: &'static str,
    /// One value a year or month.
    pub values: Vec<f64>,
    first_year: usize,
    a_year: usize,
}

impl PublicSeries {
    /// The time of the value at that place: `1898`, or `1983-02`.
    #[must_use]
    pub fn label(&self, at: usize) -> String {
        let year = self.first_year + at / self.a_year;
        match self.a_year {
            1 => year.to_string(),
            _ => format!("{year}-{:02}", at % self.a_year + 1),
        }
    }
}

/// All of them.
#[must_use]
pub fn all() -> Vec<PublicSeries> {
    vec![nile(), coal_mines(), road_casualties()]
}

/// Annual flow of the Nile at Aswan in 10⁸ m³: `Nile` of R's datasets, from Durbin and Koopman, *Time Series Analysis by State Space
/// Methods* (2001), table 2.1. It fell after 1898, with the first dam (Cobb, *The problem of the Nile*, Biometrika 65, 1978).
#[must_use]
pub fn nile() -> PublicSeries {
    PublicSeries {
        name: "the Nile",
        known: "1899",
        values: NILE.to_vec(),
        first_year: 1871,
        a_year: 1,
    }
}

/// British coal-mining disasters with 10 deaths or more, a year: Jarrett, *A note on the intervals between coal-mining disasters*,
/// Biometrika 66, 1979. They became fewer around 1890 (Carlin, Gelfand and Smith, *Hierarchical Bayesian analysis of changepoint
/// problems*, Applied Statistics 41, 1992: posterior mode 1891).
#[must_use]
pub fn coal_mines() -> PublicSeries {
    PublicSeries {
        name: "disasters in coal mines",
        known: "about 1891",
        values: COAL.iter().map(|count| f64::from(*count)).collect(),
        first_year: 1851,
        a_year: 1,
    }
}

/// Drivers killed or seriously injured in Great Britain, a month: `UKDriverDeaths` of R's datasets, from Harvey and Durbin, *The effects
/// of seat belt legislation on British road casualties*, JRSS A 149, 1986. The law is of 31 January 1983; they also fell with the
/// oil crisis of the winter of 1973. As the logarithm less the mean of the same month of all years, in percent.
#[must_use]
pub fn road_casualties() -> PublicSeries {
    const MONTHS: usize = 12;
    let logarithm = |count: &u16| 100.0 * f64::from(*count).ln();
    let of_month = |month: usize| {
        let values = ROADS.iter().skip(month).step_by(MONTHS);
        values.clone().map(logarithm).sum::<f64>() / values.count() as f64
    };
    let means: Vec<f64> = (0..MONTHS).map(of_month).collect();
    let values = ROADS.iter().zip(means.iter().cycle());
    PublicSeries {
        name: "casualties on roads",
        known: "1983-02, and about 1973-12",
        values: values.map(|(count, mean)| logarithm(count) - mean).collect(),
        first_year: 1969,
        a_year: MONTHS,
    }
}

const NILE: [f64; 100] = [
    1120.0, 1160.0, 963.0, 1210.0, 1160.0, 1160.0, 813.0, 1230.0, 1370.0, 1140.0, 995.0, 935.0, 1110.0,
    994.0, 1020.0, 960.0, 1180.0, 799.0, 958.0, 1140.0, 1100.0, 1210.0, 1150.0, 1250.0, 1260.0, 1220.0,
    1030.0, 1100.0, 774.0, 840.0, 874.0, 694.0, 940.0, 833.0, 701.0, 916.0, 692.0, 1020.0, 1050.0, 969.0,
    831.0, 726.0, 456.0, 824.0, 702.0, 1120.0, 1100.0, 832.0, 764.0, 821.0, 768.0, 845.0, 864.0, 862.0,
    698.0, 845.0, 744.0, 796.0, 1040.0, 759.0, 781.0, 865.0, 845.0, 944.0, 984.0, 897.0, 822.0, 1010.0,
    771.0, 676.0, 649.0, 846.0, 812.0, 742.0, 801.0, 1040.0, 860.0, 874.0, 848.0, 890.0, 744.0, 749.0, 838.0,
    1050.0, 918.0, 986.0, 797.0, 923.0, 975.0, 815.0, 1020.0, 906.0, 901.0, 1170.0, 912.0, 746.0, 919.0,
    718.0, 714.0, 740.0,
];

const COAL: [u8; 112] = [
    4, 5, 4, 1, 0, 4, 3, 4, 0, 6, 3, 3, 4, 0, 2, 6, 3, 3, 5, 4, 5, 3, 1, 4, 4, 1, 5, 5, 3, 4, 2, 5, 2, 2, 3,
    4, 2, 1, 3, 2, 2, 1, 1, 1, 1, 3, 0, 0, 1, 0, 1, 1, 0, 0, 3, 1, 0, 3, 2, 2, 0, 1, 1, 1, 0, 1, 0, 1, 0, 0,
    0, 2, 1, 0, 0, 0, 1, 1, 0, 2, 3, 3, 1, 1, 2, 1, 1, 1, 1, 2, 3, 3, 0, 0, 0, 1, 4, 0, 0, 0, 1, 0, 0, 0, 0,
    0, 1, 0, 0, 1, 0, 1,
];

const ROADS: [u16; 192] = [
    1687, 1508, 1507, 1385, 1632, 1511, 1559, 1630, 1579, 1653, 2152, 2148, 1752, 1765, 1717, 1558, 1575,
    1520, 1805, 1800, 1719, 2008, 2242, 2478, 2030, 1655, 1693, 1623, 1805, 1746, 1795, 1926, 1619, 1992,
    2233, 2192, 2080, 1768, 1835, 1569, 1976, 1853, 1965, 1689, 1778, 1976, 2397, 2654, 2097, 1963, 1677,
    1941, 2003, 1813, 2012, 1912, 2084, 2080, 2118, 2150, 1608, 1503, 1548, 1382, 1731, 1798, 1779, 1887,
    2004, 2077, 2092, 2051, 1577, 1356, 1652, 1382, 1519, 1421, 1442, 1543, 1656, 1561, 1905, 2199, 1473,
    1655, 1407, 1395, 1530, 1309, 1526, 1327, 1627, 1748, 1958, 2274, 1648, 1401, 1411, 1403, 1394, 1520,
    1528, 1643, 1515, 1685, 2000, 2215, 1956, 1462, 1563, 1459, 1446, 1622, 1657, 1638, 1643, 1683, 2050,
    2262, 1813, 1445, 1762, 1461, 1556, 1431, 1427, 1554, 1645, 1653, 2016, 2207, 1665, 1361, 1506, 1360,
    1453, 1522, 1460, 1552, 1548, 1827, 1737, 1941, 1474, 1458, 1542, 1404, 1522, 1385, 1641, 1510, 1681,
    1938, 1868, 1726, 1456, 1445, 1456, 1365, 1487, 1558, 1488, 1684, 1594, 1850, 1998, 2079, 1494, 1057,
    1218, 1168, 1236, 1076, 1174, 1139, 1427, 1487, 1483, 1513, 1357, 1165, 1282, 1110, 1297, 1185, 1222,
    1284, 1444, 1575, 1737, 1763,
];

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_place_has_the_time_of_its_value() {
        assert_eq!(nile().label(28), "1899");
        assert_eq!(road_casualties().label(0), "1969-01");
        assert_eq!(road_casualties().label(169), "1983-02");
    }

    #[test]
    fn seasons_are_taken_out_of_the_casualties_on_roads() {
        let values = road_casualties().values;
        for month in 0..12 {
            let mean = values.iter().skip(month).step_by(12).sum::<f64>() / 16.0;
            assert!(mean.abs() < 1e-9, "{mean}");
        }
    }
}
